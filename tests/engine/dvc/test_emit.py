from collections import OrderedDict

import pytest
from dvc.utils.serialize import dumps_yaml
from hypothesis import given
from hypothesis import strategies as st

from objectfolder.engine.dvc import lockfile
from objectfolder.engine.dvc.lockfile import lock_yaml

SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(allow_nan=False),
    st.text(max_size=20),
    st.text("0123456789abcdef", min_size=32, max_size=32),
    st.text("0123456789e", min_size=32, max_size=32),
    st.from_regex(r"[A-Za-z/._-][A-Za-z0-9/._ @-]{0,90}", fullmatch=True),
    st.sampled_from(["yes", "No", "y", "on", "True", "nan", "inf", "null", "~", "1e5", "0x1f", "1_000"]),
    st.sampled_from(["/", "a.", "a-", "a: b", "- x", "multi\nline", " b "]),
)
ENTRIES = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text("abz_.4", min_size=1), inner, max_size=4)
    ),
    max_leaves=12,
)


@given(st.dictionaries(st.text("abz_.", min_size=1), ENTRIES, min_size=1, max_size=4))
def test_text_is_that_of_dvcs_emitter(value):
    assert lock_yaml(value) == dumps_yaml(value)


def test_lock_entries_do_not_need_the_slow_emitter(monkeypatch):
    entry = OrderedDict(
        cmd="python -m stages.modal mug",
        deps=[
            {
                "path": "build/mug/solid.npz",
                "hash": "md5",
                "md5": "12345678901234567890123456789e12",
                "size": 1,
            }
        ],
        params={
            "params.yaml": OrderedDict(
                {"modal.fine": {"max_error": 0.025, "resolutions": [32, 24]}, "x": None}
            )
        },
        outs=[{"path": "build/mug/touch", "hash": "md5", "md5": f"{'ab' * 16}.dir", "nfiles": 3}],
    )
    value = {"stages": {"modal@mug": entry}}
    expected = dumps_yaml(value)
    monkeypatch.setattr(lockfile, "dumps_yaml", lambda _: pytest.fail("slow"))
    assert lock_yaml(value) == expected
