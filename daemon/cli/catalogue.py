"""Every command with its module, its reader and one line of help: what `iiwa-ident --help` prints without loading any.

A command is registered by the module named here; a test holds both lists together. The line has at most 64 letters, so
that it stands beside the command's name in a terminal of 80 columns.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Entry:
    """One command: its name, the module of `daemon.cli` that registers it, and its line in the list of commands."""

    name: str
    module: str
    line: str


GROUPS: dict[str, tuple[Entry, ...]] = {
    "Operator: examine, move, record": (
        Entry("demo", "demonstration", "The whole chain without a robot: motion to diagnosis."),
        Entry("doctor", "examination", "Examine host, network, real-time limits and link."),
        Entry("check", "acquisition", "Preflight of a motion: is it safe?"),
        Entry("run", "run", "Move the arm, record at 1 kHz, then fit."),
        Entry("investigate", "investigate", "Drive the motions that settle what recordings leave."),
        Entry("watch", "watch", "See the run that goes on; it only reads."),
        Entry("recover", "acquisition", "Make a broken-off log whole again."),
        Entry("judge", "acquisition", "Were all commands inside the limits at the robot?"),
    ),
    "Researcher: from recordings to a model": (
        Entry("import", "importing", "Bring recordings of others into this project's log."),
        Entry("fit", "analysis", "Parameters of the arm, with both solvers."),
        Entry("validate", "analysis", "RMS of a model on recordings it has not seen."),
        Entry("diagnose", "diagnosis", "Find and name what the model leaves out."),
        Entry("compare", "comparing", "What changed between recordings, dates or arms."),
        Entry("leaderboard", "comparing", "Which of several models predicts the torque best."),
        Entry("payload", "payload", "Mass, centre and inertia of a tool."),
        Entry("batch", "diagnosis", "Fit or diagnose many recordings at once."),
        Entry("feasibility", "feasibility", "Can any robot have these parameters?"),
        Entry("design", "design", "Design a motion that shows the parameters well."),
        Entry("export", "simulation", "Write the arm as URDF, SDF or MJCF."),
        Entry("twin", "twin", "The iiwa 14 for three simulators at once."),
        Entry("simulate", "simulation", "Move the identified arm under a controller."),
    ),
    "Service: one robot, a queue of runs": (
        Entry("daemon", "service", "Serve one robot and keep its queue."),
        Entry("submit", "service", "Queue one run."),
        Entry("submit-investigation", "service", "Have the service ask the arm what is open."),
        Entry("status", "service", "What the service does right now."),
        Entry("jobs", "service", "The queue, and what became of earlier jobs."),
        Entry("stop", "stop", "Ramp the arm down now and hold waiting runs."),
        Entry("resume", "service", "Let held runs take their turn again."),
        Entry("cancel", "service", "Take a waiting job out of the queue."),
        Entry("ping", "service", "Does the service answer?"),
        Entry("keys", "service", "Keys for a service that other machines may reach."),
    ),
    "Developer: no robot at hand": (
        Entry("fake-robot", "acquisition", "Stand in for the robot: a simulated arm on FRI."),
        Entry("fri", "wire", "FRI datagrams: bytes to fields and back."),
        Entry("prove", "prove", "Prove the diagnosis on concealed cases."),
    ),
}

COMMANDS = {entry.name: entry for entries in GROUPS.values() for entry in entries}
