"""The queue of things to do: order, cancellation, and the wall clock's calls from other threads."""

import threading
import time
from collections.abc import Callable
from functools import partial

import pytest
from hypothesis import given, strategies as st

from fame.clock import SECOND, Entry, Kind, Scheduler, Turns, WallScheduler
from fame.middleware.data_scheduler import DataScheduler


def test_simulated_time_jumps_to_the_next_entry_and_reads_no_wall_clock() -> None:
    scheduler, seen = Scheduler(), []
    scheduler.after(3600 * SECOND, lambda: seen.append(scheduler.now))
    started = time.monotonic()
    scheduler.run()
    assert seen == [3600 * SECOND]
    assert time.monotonic() - started < 60


def test_at_one_instant_messages_come_first_then_resumptions_then_timers_then_the_world() -> None:
    scheduler, seen = Scheduler(), []
    for kind in (Kind.WORLD, Kind.TIMER, Kind.RESUMPTION, Kind.MESSAGE):
        scheduler.at(5, lambda kind=kind: seen.append(kind), kind)
    scheduler.run()
    assert seen == [Kind.MESSAGE, Kind.RESUMPTION, Kind.TIMER, Kind.WORLD]


@given(st.lists(st.tuples(st.integers(0, 5), st.sampled_from(Kind), st.booleans()), max_size=40))
def test_the_order_is_total_by_time_then_kind_then_entry(entries: list[tuple[int, Kind, bool]]) -> None:
    scheduler, seen = Scheduler(), []
    made: list[Entry] = []
    for number, (due, kind, _) in enumerate(entries):
        made.append(scheduler.at(due, lambda number=number: seen.append(number), kind))
    for entry, (_, _, cancelled) in zip(made, entries, strict=True):
        if cancelled:
            entry.cancel()
    scheduler.run()
    kept = [number for number, (_, _, cancelled) in enumerate(entries) if not cancelled]
    assert seen == sorted(kept, key=lambda number: (entries[number][0], entries[number][1], number))


Plan = list[tuple[int, int, Kind]]


def _play(plan: Plan) -> list[tuple[int, int]]:
    """Every entry that runs takes the next line of the plan and enters what it says. Gives (time, line) of what ran."""
    scheduler, seen, lines = Scheduler(), [], iter(enumerate(plan))

    def grow(line: int) -> None:
        seen.append((scheduler.now, line))
        for _, (child, (delay, number, kind)) in zip(range(2), lines, strict=False):
            for _ in range(number):
                scheduler.after(delay, lambda child=child: grow(child), kind)

    scheduler.soon(lambda: grow(-1))
    scheduler.run(until=50)
    return seen


@given(st.lists(st.tuples(st.integers(-3, 5), st.integers(1, 3), st.sampled_from(Kind)), max_size=30))
def test_entries_made_by_entries_never_run_before_them_and_the_run_is_repeatable(plan: Plan) -> None:
    seen = _play(plan)
    assert [moment for moment, _ in seen] == sorted(moment for moment, _ in seen)
    assert len(seen) >= 1 + (plan[0][1] if plan else 0)
    assert seen == _play(plan)


def test_what_is_late_is_due_now_behind_what_was_due_before() -> None:
    scheduler, seen = Scheduler(), []

    def first() -> None:
        scheduler.at(3, lambda: seen.append("late"))
        seen.append("first")

    scheduler.at(10, first)
    scheduler.at(10, lambda: seen.append("second"))
    scheduler.run()
    assert seen == ["first", "second", "late"]
    assert scheduler.now == 10


def test_a_periodic_timer_that_counts_from_its_due_time_does_not_drift() -> None:
    scheduler, seen = Scheduler(), []

    def tick(due: int) -> None:
        seen.append(scheduler.now)
        scheduler.at(due + 3, lambda: tick(due + 3))

    scheduler.at(3, lambda: tick(3))
    scheduler.run(until=3000)
    assert seen == list(range(3, 3001, 3))


def test_run_until_includes_the_end_and_leaves_the_clock_there() -> None:
    scheduler, seen = Scheduler(), []
    for due in (5, 10, 11):
        scheduler.at(due, lambda due=due: seen.append(due))
    scheduler.run(until=10)
    assert seen == [5, 10]
    assert scheduler.now == 10
    scheduler.run(until=10)
    assert seen == [5, 10]
    scheduler.run()
    assert seen == [5, 10, 11]


def test_run_until_a_time_gone_by_does_not_turn_the_clock_back() -> None:
    scheduler = Scheduler()
    scheduler.run(until=100)
    scheduler.run(until=40)
    assert scheduler.now == 100


def test_cancelling_twice_or_after_the_run_does_nothing() -> None:
    scheduler, seen = Scheduler(), []
    entry = scheduler.soon(lambda: seen.append(1))
    scheduler.run()
    entry.cancel()
    gone = scheduler.after(1, lambda: seen.append(2))
    gone.cancel()
    gone.cancel()
    assert scheduler.next_time() is None
    scheduler.run()
    assert seen == [1]


def test_an_entry_can_cancel_another_at_the_same_instant() -> None:
    scheduler, seen = Scheduler(), []
    victim = scheduler.at(1, lambda: seen.append("victim"), Kind.TIMER)
    scheduler.at(1, victim.cancel, Kind.MESSAGE)
    scheduler.run()
    assert seen == []


def test_timers_set_and_cancelled_for_ever_take_constant_memory() -> None:
    scheduler = Scheduler()
    kept = scheduler.after(10**12, lambda: None)
    for _ in range(10_000):
        scheduler.after(10**15, lambda: None).cancel()
    assert len(scheduler) < 200
    assert scheduler.next_time() == kept.time


def test_stop_returns_after_the_entry_at_work_and_keeps_the_rest() -> None:
    scheduler, seen = Scheduler(), []
    scheduler.at(1, lambda: (seen.append(1), scheduler.stop()))
    scheduler.at(2, lambda: seen.append(2))
    scheduler.run(until=9)
    assert seen == [1]
    assert scheduler.now == 1
    scheduler.run(until=9)
    assert seen == [1, 2]


def test_what_an_action_raises_leaves_run_and_the_queue_is_whole() -> None:
    scheduler, seen = Scheduler(), []
    scheduler.at(1, lambda: 1 // 0)
    scheduler.at(2, lambda: seen.append(2))
    with pytest.raises(ZeroDivisionError):
        scheduler.run()
    scheduler.run()
    assert seen == [2]


@pytest.mark.parametrize("make", [Scheduler, WallScheduler])
def test_an_entry_must_not_run_the_scheduler(make: Callable[[], Scheduler]) -> None:
    scheduler = make()
    scheduler.soon(lambda: scheduler.run(until=0))
    with pytest.raises(RuntimeError, match="runs already"):
        scheduler.run()


# ---- the wall clock --------------------------------------------------------------------------------------------------


def test_the_wall_clock_waits_for_what_is_due_and_goes_on_by_itself() -> None:
    scheduler, seen = WallScheduler(), []
    scheduler.after(SECOND // 1000, lambda: seen.append(scheduler.now))
    scheduler.run(until=scheduler.now + SECOND // 500)
    assert seen
    assert seen[0] >= SECOND // 1000
    assert scheduler.now >= SECOND // 500


def test_work_from_many_threads_is_done_by_the_running_one_in_the_order_of_each() -> None:
    scheduler, seen = WallScheduler(), []
    done = threading.Barrier(4, action=lambda: scheduler.soon(scheduler.stop))

    def give(name: int) -> None:
        for number in range(200):
            scheduler.soon(lambda number=number: seen.append((name, number, threading.get_ident())))
        done.wait()

    threads = [threading.Thread(target=give, args=(name,)) for name in range(4)]
    for thread in threads:
        thread.start()
    scheduler.run()
    for thread in threads:
        thread.join()
    assert {ident for _, _, ident in seen} == {threading.get_ident()}
    for name in range(4):
        assert [number for owner, number, _ in seen if owner == name] == list(range(200))


def test_an_idle_run_wakes_up_for_work_from_another_thread_and_for_stop() -> None:
    scheduler, seen = WallScheduler(), []
    runner = threading.Thread(target=scheduler.run)
    runner.start()
    worked = threading.Event()
    scheduler.soon(lambda: (seen.append(threading.get_ident()), worked.set()))
    assert worked.wait(60)
    assert seen == [runner.ident]
    scheduler.stop()
    runner.join(60)
    assert not runner.is_alive()


def test_a_stop_said_just_before_run_is_not_lost() -> None:
    scheduler, seen = WallScheduler(), []
    scheduler.soon(lambda: seen.append(1))
    scheduler.stop()
    scheduler.run()
    assert seen == []
    scheduler.run(until=scheduler.now)
    assert seen == [1]


def test_an_entry_that_enters_itself_again_starves_neither_timers_nor_the_end_of_the_run() -> None:
    scheduler, seen = WallScheduler(), []

    def again() -> None:
        scheduler.at(0, again, Kind.MESSAGE)

    again()
    scheduler.after(SECOND // 1000, lambda: seen.append("timer"), Kind.TIMER)
    scheduler.run(until=scheduler.now + SECOND // 200)
    assert seen == ["timer"]


def test_a_timer_of_the_far_future_does_not_stop_the_wall_clock() -> None:
    scheduler = WallScheduler()
    scheduler.at(10**20, lambda: None)
    threading.Timer(0.01, scheduler.stop).start()
    scheduler.run()
    assert scheduler.next_time() == 10**20


def test_cancelling_from_other_threads_while_it_runs_loses_nothing_else() -> None:
    scheduler, seen = WallScheduler(), []
    entries = [scheduler.at(0, lambda number=number: seen.append(number)) for number in range(2000)]
    canceller = threading.Thread(target=lambda: [entry.cancel() for entry in entries[1::2]])
    scheduler.soon(canceller.start)
    scheduler.run(until=scheduler.now)
    canceller.join()
    assert [number for number in seen if number % 2 == 0] == list(range(0, 2000, 2))


def test_of_many_due_entries_of_a_mission_one_runs_before_what_others_enter() -> None:
    wall, seen = Scheduler(), []
    turns = Turns(wall)
    for number in range(1000):
        turns.after(5, partial(seen.append, number))
    turns.after(5, lambda: None).cancel()
    wall.at(6, lambda: seen.append("message"), Kind.MESSAGE)
    wall.at(5, lambda: wall.soon(lambda: seen.append("reply")))
    wall.run()
    assert seen[:3] == [0, "reply", 1]
    assert [each for each in seen if isinstance(each, int)] == list(range(1000))


def test_a_mission_that_enters_itself_again_lets_others_run_and_its_time_is_that_of_the_wall() -> None:
    wall, seen = Scheduler(), []
    turns = Turns(wall)

    def again() -> None:
        seen.append("again")
        if len(seen) < 100:
            turns.soon(again)

    turns.after(7, again)
    wall.at(7, lambda: seen.append(turns.now))
    wall.run()
    assert seen[:2] == ["again", 7]


class Arrivals:
    """A waiter that has these messages, one each time."""

    def __init__(self, scheduler: DataScheduler, *actions: Callable[[], object]) -> None:
        self.scheduler, self.actions = scheduler, list(actions)

    def wait(self, timeout: int) -> None:
        if self.actions:
            self.scheduler.arrived(self.actions.pop(0))

    def wake(self) -> None: ...


def test_a_message_comes_after_what_was_due_before_it_and_before_what_is_due_later() -> None:
    scheduler, seen = DataScheduler(), list[str]()
    scheduler.at(0, lambda: seen.append("before")).cancel()
    scheduler.at(1, lambda: seen.append("before"))

    def first() -> None:
        seen.append("first")
        scheduler.soon(lambda: seen.append("later"))
        scheduler.after(SECOND // 100, scheduler.stop)

    scheduler.waiter = Arrivals(scheduler, first, lambda: seen.append("second"))
    scheduler.run()
    assert seen[:2] == ["before", "first"]
    assert sorted(seen[2:]) == ["later", "second"]


def test_a_message_that_came_at_the_end_of_a_run_is_for_the_next() -> None:
    scheduler, seen = DataScheduler(), list[str]()
    scheduler.waiter = arrivals = Arrivals(scheduler, lambda: seen.append("message"))
    while arrivals.actions:
        scheduler.run(until=scheduler.now)
    scheduler.run(until=scheduler.now)
    assert seen == ["message"]


def test_a_message_that_another_thread_has_handled_runs_in_that_of_the_scheduler() -> None:
    scheduler, seen = DataScheduler(), list[int]()
    scheduler.run(until=scheduler.now)

    def note() -> None:
        seen.append(threading.get_ident())

    other = threading.Thread(target=scheduler.arrived, args=(note,))
    other.start()
    other.join()
    scheduler.run(until=scheduler.now)
    assert seen == [threading.get_ident()]
