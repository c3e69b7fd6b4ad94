"""The live view as a terminal shows it: one screen of text from the newest frame; pure, with rich.

Here: what stands where, bars and colours. Not here: when it is drawn and where (`cli.live_view`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from daemon.live.frame import LiveFrame
from daemon.live.residual import REMARKABLE
from identification.arrays import FloatArray
from safety.limits import EXTERNAL_TORQUE_THRESHOLD_NM, JointLimits

_NEAR, _TOO_NEAR = 0.75, 0.9
"""Share of a limit from which a bar is yellow, and red."""
_HALVES = (2, 10)
"""Characters of a bar on each side of its zero, at least and at most."""
_NUMBERS_WIDE = {False: 57, True: 64}
"""Columns of a line without its four bars; True: with the model's torque as a number, beside its mark in the bar."""
_ROOMY = 100
"""Columns from which it is there."""
_NUMBER_WIDE = 6
_NAME_WIDE, _COLUMN_WIDE = 2, 8
"""Columns of a joint's name, and of a number at most with the space before it."""
_WIDE = 40
_GOOD = {"EXCELLENT": "green", "GOOD": "green", "FAIR": "yellow", "POOR": "bold red"}


@dataclass(frozen=True, slots=True, eq=False)
class Screen:
    """All that one screen shows. velocity: rad/s, modelled: Nm, ratio: see `residual`, each (7,) or None.

    external_limit: Nm per joint, None: not watched. remark: one sentence below. silent_s: since the last frame.
    """

    frame: LiveFrame
    limits: JointLimits
    external_limit: tuple[float, ...] | None = EXTERNAL_TORQUE_THRESHOLD_NM
    velocity: FloatArray | None = None
    modelled: FloatArray | None = None
    ratio: FloatArray | None = None
    remark: str = ""
    silent_s: float = 0.0
    width: int = field(default=120, kw_only=True)
    ascii_only: bool = field(default=False, kw_only=True)

    @property
    def half(self) -> int:
        """Characters of a bar on each side of its zero, as the width of the terminal allows."""
        least, most = _HALVES
        return max(least, min(most, (self.width - _NUMBERS_WIDE[self.is_roomy]) // 8))

    @property
    def has_bars(self) -> bool:
        """Whether there is room for bars at all; without them the numbers stand alone, each behind its joint."""
        return self.width >= _NUMBERS_WIDE[False] + 4 * (2 * _HALVES[0] + 1)

    @property
    def is_roomy(self) -> bool:
        """Whether there is room for what the bars say as well."""
        return self.width >= _ROOMY


def remaining_s(frame: LiveFrame) -> float | None:
    """Seconds of excitation that are still to come; None where they cannot be told."""
    if not frame.rows_per_period or frame.phase not in ("START_RAMP", "LEAD_IN", "EXCITATION"):
        return None
    periods_left = frame.periods - max(frame.period, 0)
    return (periods_left * frame.rows_per_period - max(frame.sample_in_period, 0)) * frame.table_period_s


def drawn(screen: Screen) -> RenderableType:
    """The whole view: where the run is, the link, one line for each joint, the newest event."""
    parts: list[RenderableType] = [_place(screen), _link(screen)]
    if screen.frame.position is not None:
        parts.append(_joints(screen))
    parts += [Text(sentence) for sentence in (screen.remark, screen.frame.event) if sentence]
    return Group(*parts)


def bar(
    value: float, lower: float, upper: float, *, half: int = 5, mark: float | None = None, ascii_only: bool = False
) -> Text:
    """A bar from the middle to the share of the limit that a value takes on its side; mark: another value, as a sign.

    lower < upper; zero stands in the middle, whatever the limits. half: characters on each side of it.
    """
    full, empty, middle, sign = "#-|o" if ascii_only else "█·│◆"
    share = _share(value, lower, upper)
    length = min(half, round(abs(share) * half))
    signs = [empty] * half + [middle] + [empty] * half
    step = 1 if share > 0 else -1
    for place in range(1, length + 1):
        signs[half + step * place] = full
    colour = "bold red" if abs(share) >= _TOO_NEAR else "yellow" if abs(share) >= _NEAR else "green"
    text = Text("".join(signs), style=colour)
    if mark is not None:
        place = half + max(-half, min(half, round(_share(mark, lower, upper) * half)))
        text = Text.assemble(text[:place], (sign, "cyan"), text[place + 1 :])
    return text


def _share(value: float, lower: float, upper: float) -> float:
    """Of the limit on the value's side, with its sign: -1 at the lower limit, 1 at the upper one."""
    limit = upper if value > 0.0 else -lower
    return value / limit if limit > 0.0 else 0.0


def _place(screen: Screen) -> Text:
    frame, left = screen.frame, remaining_s(screen.frame)
    full, empty = "#-" if screen.ascii_only else "━─"
    facts = [Text(f"Run {frame.run_id}"), Text(frame.robot)]
    facts.append(Text(frame.phase.lower().replace("_", " ") or "waiting", style="bold"))
    if frame.period >= 0:
        facts.append(Text(f"period {frame.period + 1} of {frame.periods}"))
    text = _beside(facts, screen.width)
    if left is not None:
        whole = frame.periods * frame.rows_per_period * frame.table_period_s
        done = 1.0 - left / whole
        said = f" {100.0 * done:3.0f} %  {int(left // 60)}:{int(left % 60):02d} remain"
        wide = max(0, min(_WIDE, screen.width - len(said)))
        length = round(done * wide)
        text.append("\n")
        text.append(full * length, style="green").append(empty * (wide - length), style="dim").append(said)
    return text


def _link(screen: Screen) -> Text:
    frame = screen.frame
    facts = [Text(frame.session_state), Text.assemble("link ", (frame.quality, _GOOD.get(frame.quality, "")))]
    facts.append(Text(f"received {frame.received}"))
    for name in ("late", "missing", "lost"):
        count = getattr(frame, name)
        facts.append(Text(f"{name} {count}", style="bold red" if count else ""))
    if screen.silent_s >= 1.0:
        facts.append(Text(f"NO FRAME FOR {screen.silent_s:.0f} s", style="bold red"))
    return _beside(facts, screen.width)


def _beside(facts: list[Text], width: int) -> Text:
    """Facts beside each other, and below where there is no room: a line ends between two of them, in none."""
    text, used = facts[0].copy(), len(facts[0])
    for fact in facts[1:]:
        fits = used + 2 + len(fact) <= width
        used = used + 2 + len(fact) if fits else len(fact)
        text.append("  " if fits else "\n").append_text(fact)
    return text


def _joints(screen: Screen) -> Table:
    """One line a joint: bars against the limits, the numbers beside them."""
    frame, limits = screen.frame, screen.limits
    position = np.array(frame.position)
    external = None if frame.external_torque is None else np.array(frame.external_torque)
    torque = None if frame.torque is None else np.array(frame.torque)
    modelled = screen.modelled
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False)
    heads = ["", "position", "rad", "velocity", "rad/s", "torque", "Nm"]
    if modelled is not None:
        heads += ["model", "differ", "× noise"] if screen.is_roomy else ["differ", "× noise"]
    heads += ["external", "Nm"]
    if not screen.has_bars:
        heads = ["", "rad", "rad/s", "Nm", *(["differ", "× noise"] if modelled is not None else []), "ext."]
        heads = heads[: 1 + (screen.width - _NAME_WIDE) // _COLUMN_WIDE]
    for head in heads:
        left = head in ("", "position", "velocity", "torque", "external")
        shown = head.replace("×", "x") if screen.ascii_only else head
        table.add_column(
            shown, justify="left" if left else "right", no_wrap=True, min_width=None if left else _NUMBER_WIDE
        )
    for joint in range(7):
        cells: list[RenderableType] = [f"A{joint + 1}"]
        cells += _pair(screen, position[joint], limits.position_lower[joint], limits.position_upper[joint], "+.3f")
        cells += _pair(screen, _at(screen.velocity, joint), -limits.velocity[joint], limits.velocity[joint], "+.3f")
        foreseen = _at(modelled, joint)
        cells += _pair(screen, _at(torque, joint), -limits.torque[joint], limits.torque[joint], "+.2f", mark=foreseen)
        if foreseen is not None:
            measured, ratio = _at(torque, joint), _at(screen.ratio, joint)
            if screen.is_roomy:
                cells.append(f"{foreseen:+.2f}")
            cells.append("" if measured is None else f"{measured - foreseen:+.2f}")
            cells.append("" if ratio is None else Text(f"{ratio:.1f}", "bold red" if ratio >= REMARKABLE else ""))
        limit = None if screen.external_limit is None else screen.external_limit[joint]
        # Where nobody watches it there is no limit to draw against; the joint's own torque is the scale.
        scale = float(limits.torque[joint]) if limit is None else limit
        cells += _pair(screen, _at(external, joint), -scale, scale, "+.2f")
        table.add_row(*cells[: len(heads)])
    return table


def _at(values: FloatArray | None, joint: int) -> float | None:
    return None if values is None else float(values[joint])


def _pair(
    screen: Screen, value: float | None, lower: float, upper: float, spelled: str, *, mark: float | None = None
) -> list[RenderableType]:
    if not screen.has_bars:
        return ["" if value is None else format(float(value), spelled)]
    if value is None:
        return ["", ""]
    shown = bar(float(value), float(lower), float(upper), half=screen.half, mark=mark, ascii_only=screen.ascii_only)
    return [shown, format(float(value), spelled)]
