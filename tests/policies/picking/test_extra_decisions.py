"""How often a part may be moved without being delivered."""

import numpy as np

from policies.picking.extra_decisions import ExtraDecisions

HERE, THERE, FAR = np.zeros(3), np.array([0.06, 0.0, 0.0]), np.array([0.2, 0.0, 0.0])


def after(decisions: int, *moves: tuple[np.ndarray, np.ndarray]) -> ExtraDecisions:
    extra = ExtraDecisions(radius=0.04)
    for _ in range(decisions):
        extra.decided()
    for where, to in moves:
        extra.moved(where, to)
    return extra


def test_a_fifth_of_the_decisions_may_move_parts() -> None:
    assert not after(3).allows(HERE)
    assert after(4).allows(HERE)
    assert not after(8, (FAR, FAR)).allows(HERE)
    assert after(9, (FAR, FAR)).allows(HERE)


def test_decisions_that_are_still_to_come_count_where_they_are_certain() -> None:
    assert after(0).allows(HERE, expected=4)
    assert not after(0).allows(HERE, expected=3)


def test_a_part_is_moved_twice_and_its_count_goes_with_it() -> None:
    extra = after(100, (HERE, THERE))
    assert extra.allows(THERE)
    extra.moved(THERE, FAR)
    assert not extra.allows(FAR)
    assert extra.allows(HERE)


def test_put_backs_count_as_moves_and_apart_from_pushes():
    extra = after(100, (HERE, THERE))
    assert extra.times_put_back(THERE) == 0
    extra.put_back(THERE, FAR)
    assert extra.times_put_back(FAR) == 1
    assert not extra.allows(FAR)


def test_a_part_that_did_not_follow_counts_where_it_was_and_on_the_way():
    extra = after(100, (HERE, FAR), (HERE, FAR))
    assert not extra.allows(HERE)
    assert not extra.allows(0.5 * (HERE + FAR))
    assert not extra.allows(FAR)
    assert extra.allows(FAR + THERE)
