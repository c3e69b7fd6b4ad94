"""The command `twin`: the iiwa 14 for three simulators at once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from daemon.cli.app import app
from daemon.cli.output import JsonOption, data, data_lines, told_in_words
from daemon.cli.protection import folder_to_write
from daemon.cli.simulation import MotorInertiaOption, motor_prior, read_back
from daemon.folders import make_folder

NAMES = {"urdf": "{}.urdf", "mjcf": "{}.xml", "sdf": "{}.sdf"}


@app.command()
def twin(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the files.", callback=folder_to_write)],
    model_file: Annotated[
        Path | None,
        typer.Option("--model", metavar="MODEL.json", help="An arm of yours instead of the paper's Table 3."),
    ] = None,
    motor_inertia: MotorInertiaOption = False,
    json_file: JsonOption = None,
) -> None:
    """The iiwa 14 as URDF, MJCF and SDF: bodies that can exist, friction, rotor inertia where the format has a place.

    Without --model: the arm of the paper's Table 3, moved to the nearest one made of matter; the distance is said.
    Each file is read back by every simulator that is installed.
    Example: iiwa-ident twin --out twin
    """
    from identification.export.twin import twin_of_table_three
    from identification.export.write import export_model
    from identification.model_file import read_model, write_model
    from identification.robots.joint_units import in_units

    make_folder(out)
    sentence, parameters = "", "consistent"
    if model_file is None:
        found = twin_of_table_three()
        sentence, parameters = found.sentence, "physical"
        model_file = write_model(found.to_model_json(), out / "iiwa14.model.json")
    model = read_model(model_file)
    robot = model.load_robot()
    added = motor_prior(model, parameters) if motor_inertia else None
    results = {
        form: export_model(
            model, out / name.format(robot.name), form, parameter_set=parameters, motor_inertia=added
        )
        for form, name in NAMES.items()
    }  # fmt: skip
    written = {
        "model": str(model_file),
        "sentence": sentence,
        "files": {form: str(result.path) for form, result in results.items()},
        "read_back": {form: read_back(result) for form, result in results.items()},
    }
    if not told_in_words(written, json_file):
        return
    if sentence:
        data(sentence)
    for result in results.values():
        data(f"Written to {result.path}")
        data_lines(f"  {in_units(agreement.sentence(), robot.units)}" for agreement in result.agreements)
    data_lines(f"note: {note}" for note in dict.fromkeys(note for result in results.values() for note in result.notes))
