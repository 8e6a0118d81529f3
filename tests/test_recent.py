import gc
import weakref

from objectfolder.base.recent import Recent


def test_the_ones_asked_for_last_are_kept():
    made = []
    recent = Recent(2)

    def ask(key):
        return recent.of(key, lambda: made.append(key) or key.upper())

    assert [ask(key) for key in "abacab"] == list("ABACAB")
    assert made == list("abcb")  # c pushed b out, as a was asked for again


def test_an_object_that_keeps_values_goes_with_its_last_reference():
    class Keeper:
        def __init__(self):
            self.recent = Recent(1)

        def value(self):
            return self.recent.of(0, lambda: self.made())

        def made(self):
            return [1]

    gc.disable()
    try:
        keeper = Keeper()
        gone = weakref.ref(keeper)
        assert keeper.value() is keeper.value()
        del keeper
        assert gone() is None
    finally:
        gc.enable()
