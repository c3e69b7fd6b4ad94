"""What a number or an address of a run may be: one rule each, for options, configuration, requests and the service."""

from __future__ import annotations

from typing import Any

from daemon.endpoints import is_ipv4

SMALLEST_AMPLITUDE, LARGEST_AMPLITUDE = 0.01, 1.0
"""Fraction of itself that a motion is driven at. With less the arm hardly leaves its pose; with more it leaves what was
designed."""
LONGEST_SILENCE_S = 60.0
LONGEST_LEAD_IN_S = 60.0
FARTHEST_FROM_MEASURED_RAD = 0.5
LARGEST_TORQUE_NM = 400.0
"""Beyond these a number is meant in ms, degrees or mNm, and would switch the protection off that it is to set."""
FEWEST_RING_SLOTS, MOST_RING_SLOTS = 1024, 2**19
"""Of 2 kB each: the most are 1 GB, nine minutes that the recorder may be late at 1 kHz; fewer than a second's are full
before the recorder, which frees them four times a second, comes round."""


def reason_against(name: str, value: Any) -> str | None:
    """Why a setting of this name cannot have this value; None where it can, and for a name that has no range."""
    if value is None:
        return None
    match name:
        case "amplitude" if not SMALLEST_AMPLITUDE <= value <= LARGEST_AMPLITUDE:
            return f"{value:g} is outside {SMALLEST_AMPLITUDE:g} to {LARGEST_AMPLITUDE:g}."
        case "periods" if value < 1:
            return f"{value} periods asked for; at least 1 is needed."
        case "bind_host" | "robot_host" if not is_ipv4(value):
            return f"'{value}' is no IPv4 address, such as 192.170.10.2."
        case "bind_port" if not 0 <= value <= 65535:
            return f"{value} is not a UDP port (0 to 65535)."
        case "receive_timeout_s" if value > LONGEST_SILENCE_S:
            return f"{value:g} s of silence are too many ({LONGEST_SILENCE_S:g} s)."
        case "table_period_s" | "receive_timeout_s" | "start_timeout_s" | "command_timeout_s":
            return None if 0.0 < value < float("inf") else f"{value:g} must be a positive number of seconds."
        case "lead_in_s" if not 0.0 <= value <= LONGEST_LEAD_IN_S:
            return f"{value:g} s is outside 0 to {LONGEST_LEAD_IN_S:g} s."
        case "maximum_distance_to_measured" if not 0.0 < value <= FARTHEST_FROM_MEASURED_RAD:
            return f"{value:g} rad is no distance of 0 to {FARTHEST_FROM_MEASURED_RAD:g} rad."
        case "external_torque_limit" if len(value) != 7 or not all(0.0 < limit <= LARGEST_TORQUE_NM for limit in value):
            return f"7 positive torques of at most {LARGEST_TORQUE_NM:g} Nm are needed, not {list(value)}."
        case "ring_slots" if not FEWEST_RING_SLOTS <= value <= MOST_RING_SLOTS:
            return f"{value} slots are not between {FEWEST_RING_SLOTS} and {MOST_RING_SLOTS}."
        case "priority" if not 0 <= value <= 90:
            return f"{value} is outside 0 to 90; above 90 starves the kernel's threads."
        case "cpu" if value < 0:
            return f"{value} is no processor; the first is 0."
    return None
