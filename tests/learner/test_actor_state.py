"""What the learner remembers of each actor: over checkpoints, deaths and departures every episode is accounted for."""

from __future__ import annotations

from giirl_core.wire import delivery
from tests.giirl_core.wire_examples import assert_same_episode, episode
from tests.learner.admitting import Learner


def test_a_checkpoint_brings_back_what_was_held_and_refuses_what_was_judged() -> None:
    learner = Learner()
    learner.hello()
    for sequence in (0, 1, 3):
        learner.episode(sequence)
    learner.seeds(1)
    held = learner.books.snapshot()
    resumed = Learner(held=held)
    assert resumed.episode(1) == "unknown_actor"
    resumed.hello()
    grant = resumed.grant()
    assert (grant.low_watermark, grant.acked, grant.committed) == (2, (3,), 2)
    for sequence in (0, 1, 2, 3):
        resumed.episode(sequence)
    assert resumed.seeds(3) == [1, 3, 2]
    assert resumed.dropped("duplicate") == 3
    assert_same_episode(held.episodes[0], episode(1, seed=1, reward_version=2))


def test_only_what_the_checkpoint_holds_is_committed() -> None:
    learner = Learner()
    learner.hello()
    learner.episode(0)
    held = learner.books.snapshot()
    learner.episode(1)
    assert learner.grant().committed == 0
    learner.books.commit(held)
    assert learner.grant().committed == 1
    learner.hello(incarnation=1)
    learner.books.commit(held)  # of an incarnation that is gone
    assert learner.grant().committed == 0


def test_episodes_an_actor_no_longer_has_and_nobody_saw_are_counted_as_lost() -> None:
    learner = Learner()
    learner.hello()
    learner.episode(1)
    learner.hello(4)
    assert learner.dropped("lost") == 3  # 0, 2 and 3
    assert learner.grant().low_watermark == 4
    learner.hello(2**40)  # in one stride
    assert learner.dropped("lost") == 3 + 2**40 - 4


def test_what_a_dead_incarnation_had_finished_and_nobody_saw_is_counted_as_lost() -> None:
    learner = Learner()
    learner.hello()
    learner.episode(0)
    learner.episode(2)
    learner.hello(incarnation=3, before=((0, 5), (2, 4)))
    assert learner.dropped("lost") == 3 + 4
    learner.hello(incarnation=3, before=((0, 5), (2, 4)))  # said again, counted once
    assert learner.dropped("lost") == 7


def test_without_its_successors_word_the_last_of_its_own_counts() -> None:
    learner = Learner()
    learner.hello(finished=6)
    learner.episode(0)
    learner.hello(incarnation=1)
    assert learner.dropped("lost") == 5


def test_an_actor_that_says_good_bye_leaves_nothing_unaccounted() -> None:
    learner = Learner()
    learner.hello()
    learner.episode(1)
    learner.notice(delivery.BYE, finished=4)
    assert learner.dropped("lost") == 3
    assert learner.books.silent_for_s("a") == float("inf")
    learner.hello(incarnation=1, before=((0, 4),))
    assert learner.dropped("lost") == 3


def test_what_was_counted_since_a_checkpoint_is_counted_again_by_who_goes_back_to_it() -> None:
    learner = Learner()
    learner.hello()
    learner.episode(0)
    held = learner.books.snapshot()
    learner.hello(incarnation=1, before=((0, 3),))
    assert learner.books.snapshot().counts == {"lost": 2}
    resumed = Learner(held=held)
    resumed.hello(incarnation=2, before=((0, 3), (1, 1)))
    assert resumed.books.snapshot().counts == {"lost": 3}
    assert resumed.grant().settled == 0  # both may be asked for again
    resumed.books.commit(resumed.books.snapshot())
    assert resumed.grant().settled == 2


def test_an_actor_that_keeps_too_much_asks_for_a_checkpoint_that_frees_it() -> None:
    learner = Learner()
    learner.hello(full=True)
    assert not learner.books.wants_commit  # none would help
    learner.episode(0)
    learner.notice(delivery.HEARTBEAT, full=True, finished=1)
    assert learner.books.wants_commit
    learner.books.commit(learner.books.snapshot())
    assert not learner.books.wants_commit


def test_an_actor_that_is_gone_for_good_leaves_nothing_unaccounted_and_may_be_replaced() -> None:
    learner = Learner()
    learner.hello(finished=4)
    learner.episode(0)
    learner.books.retire("a", ((0, 5),))  # by its own count; the learner knew of four
    assert learner.dropped("lost") == 4
    learner.books.retire("a", ((0, 5),))
    assert learner.dropped("lost") == 4  # once
    assert learner.seeds(1) == [0]  # what had come is used
    learner.hello(incarnation=1, before=((0, 5),))
    assert learner.dropped("lost") == 4
    learner.episode(0, incarnation=1)
    assert learner.seeds(1) == [0]


def test_of_an_actor_that_was_never_heard_its_own_count_is_lost() -> None:
    learner = Learner()
    learner.books.retire("a", ())
    assert learner.books.snapshot().marks == ()
    learner.books.retire("a", ((3, 2), (4, 1)))
    assert learner.dropped("lost") == 3
    (mark,) = learner.books.snapshot().marks
    assert (mark.incarnation, mark.low_watermark, mark.finished) == (4, 1, 1)


def test_one_that_comes_back_from_the_grave_has_nothing_trained_on_twice() -> None:
    learner = Learner()
    learner.hello(finished=2)
    learner.books.retire("a", ((0, 2),))
    assert learner.episode(1) == "unknown_actor"
    learner.hello(finished=2)
    assert learner.grant().low_watermark == 2
    learner.episode(1)
    assert learner.dropped("duplicate") == 1
    assert learner.dropped("lost") == 2
