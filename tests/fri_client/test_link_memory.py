"""What is remembered of the last second, and the clause an operator reads."""

from __future__ import annotations

from fri_client.session.link_memory import LinkMemory

MS = 1_000_000


def test_only_the_last_second_counts_however_long_the_run_was() -> None:
    memory = LinkMemory()
    for k in range(10_000):
        late = k in (3000, 9500)
        memory.tick(k * MS, k * MS + (7 * MS if late else MS // 5), 40 if k == 8000 else 2 if k == 9900 else 0)
    recent = memory.recall(10_000 * MS)
    assert (recent.missing, recent.answered, recent.turn_around_ms) == (2, 999, 7.0)
    assert memory.recall(11_500 * MS).answered == 0


def test_a_message_without_an_answer_has_no_turn_around() -> None:
    memory = LinkMemory()
    memory.tick(5 * MS, 0, 3)
    recent = memory.recall(6 * MS)
    assert (recent.missing, recent.answered, recent.turn_around_ms) == (3, 0, None)
    assert "3 messages missing and no answer" in recent.clause()


def test_a_computer_that_was_held_up_shows_as_a_pause_though_nothing_is_missing() -> None:
    """Of one held for two seconds, 250 messages late, the sentence said: 0 missing, longest turn-around 0.2 ms."""
    memory = LinkMemory()
    for k in range(5000):
        memory.tick(k * MS, k * MS + MS // 5, 0)
    assert memory.recall(5000 * MS).pause_ms == 1.0
    memory.tick(7000 * MS, 0, 0)  # the kernel had kept those that came meanwhile
    recent = memory.recall(7000 * MS)
    assert recent.pause_ms == memory.recall(7900 * MS).pause_ms == 2001.0
    assert "0 messages missing and no answer, longest pause between messages 2001 ms;" in recent.clause()
    assert memory.recall(9000 * MS).pause_ms == 2000.0  # none came since


def test_answers_that_were_held_back_are_told() -> None:
    """Of a robot whose quality fell since every eighth answer was, the sentence said: 0 missing, 0.2 ms."""
    memory = LinkMemory()
    for k in range(2000):
        held = k % 8 == 0
        memory.tick(k * MS, 0 if held else k * MS + MS // 5, 0, held_back=held)
    assert "0 messages missing, 125 answers held back and longest" in memory.recall(1999 * MS).clause()
    assert "held back" not in memory.recall(4000 * MS).clause()


def test_the_qualities_are_told_in_their_order_with_their_age() -> None:
    memory = LinkMemory()
    memory.quality(0, 0, 3)
    memory.forget_qualities()
    memory.tick(1, 100_001, 0)
    assert "quality unchanged in the motion" in memory.recall(2).clause()
    memory.quality(1000 * MS, 3, 2)
    memory.quality(3000 * MS, 2, 1)
    assert memory.recall(3100 * MS).clause().endswith("quality EXCELLENT -> GOOD 2.10 s before -> FAIR 0.10 s before")
    for k in range(100):
        memory.quality(k, k % 4, (k + 1) % 4)
    assert len(memory.recall(100).qualities) == 8
