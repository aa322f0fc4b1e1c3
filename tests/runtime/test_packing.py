"""Frames that leave together arrive one by one, in order; damage is what the node refuses."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from strands_actors.runtime.frames import TELL, frame
from strands_actors.runtime.zenoh_mesh import packed, unpacked

from .kernel import Number


@given(st.lists(st.integers(0, 2**40), min_size=1, max_size=100))
def test_what_was_packed_is_unpacked(values: list[int]) -> None:
    frames = [frame("strands/r/actor/a", TELL, 0, "s", "n", Number(value)) for value in values]
    assert list(unpacked(packed(frames))) == frames


def test_one_alone_travels_as_itself() -> None:
    alone = frame("strands/r/actor/a", TELL, 0, "s", "n", Number(1))
    assert packed([alone]) == alone


@given(st.binary(max_size=300))
def test_nothing_is_made_up_and_it_ends(data: bytes) -> None:
    assert sum(map(len, unpacked(data))) <= len(data)


@given(st.binary(max_size=300))
def test_damaged_packs_end_too(data: bytes) -> None:
    assert sum(map(len, unpacked(b"\xc1" + data))) <= len(data)
