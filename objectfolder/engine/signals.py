"""Stop a build cleanly on SIGINT, SIGTERM or SIGHUP."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class _Interrupted(Exception):
    """A signal asked the build to stop."""


class StopSignals:
    """Turns the first signal into a clean stop; a second one raises KeyboardInterrupt at once.

    ``wake``: called from the signal handler, to end a wait of the main loop; ``on_interrupt``: called by the
    main loop, once it sees that the user interrupts it; not if the terminal is gone.
    """

    def __init__(self, wake: Callable[[], None], on_interrupt: Callable[[], None]):
        self._wake = wake
        self._on_interrupt = on_interrupt
        self._number: int | None = None

    def raise_if_caught(self) -> None:
        """Leave the block of `catch` if a signal has arrived."""
        if self._number is None:
            return
        if self._number == signal.SIGINT:
            self._on_interrupt()
        raise _Interrupted

    @contextmanager
    def catch(self) -> Iterator[None]:
        """Handle signals in the block; a caught one ends it with KeyboardInterrupt or SystemExit."""
        if threading.current_thread() is not threading.main_thread():
            yield  # only the main thread may handle signals; its handlers belong to the caller
            return

        def handle(number: int, frame: object) -> None:
            if self._number is not None:
                raise KeyboardInterrupt
            self._number = number
            self._wake()

        # A signal that is ignored (nohup, background jobs) stays ignored.
        handled = [number for number in SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
        before = {number: signal.signal(number, handle) for number in handled}
        try:
            yield
        except _Interrupted:
            if self._number is None or self._number == signal.SIGINT:
                raise KeyboardInterrupt from None
            raise SystemExit(128 + self._number) from None
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
