"""Files of a case as a user has them: robot file, model, split, and a Parquet log."""

import os
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from simgap.logs import Logs
from simgap.robot import Robot

ROBOT_FILE: Final = "robot.toml"


def write_robot(folder: Path, robot: Robot, held_out: frozenset[str], motions: tuple[str, ...]) -> None:
    """Write robot file, model and split of a robot."""
    folder.mkdir(parents=True, exist_ok=True)
    step_s = float(robot.model.opt.timestep)
    lines = [
        f'name = "{robot.name}"',
        'model = "model.xml"',
        'split = "split.toml"',
        f"time_step_s = {step_s:g}",
        f"control_rate_Hz = {1.0 / robot.control_period_s:g}",
        f'tool_site = "{robot.tool_site}"',
        "",
        "[time]",
        'column = "t_s"',
        'unit = "s"',
        "",
        "[motion]",
        'columns = ["motion"]',
        'repeat_column = "repeat"',
    ]
    for joint in robot.joints:
        lines += [
            "",
            f"[joints.{joint.name}]",
            'mode = "position"',
            f"kp_Nm_rad = {joint.kp_Nm_rad!r}",
            f"kd_Nms_rad = {joint.kd_Nms_rad!r}",
            f"torque_limit_Nm = {joint.torque_limit_Nm!r}",
            f"is_known = {str(joint.is_known).lower()}",
            f'command = {{ column = "command_{joint.name}", unit = "rad" }}',
            f'position = {{ column = "position_{joint.name}", unit = "rad" }}',
            f'temperature = {{ column = "temperature_{joint.name}", unit = "degC" }}',
        ]
    fitted = [name for name in motions if name not in held_out]
    split = [
        'default = "fit"',
        "",
        "[parts]",
        f"fit = {_strings(fitted)}",
        f"held_out = {_strings(sorted(held_out))}",
        "",
        "[splits.fit]",
        'fit = ["fit"]',
        'held_out = ["held_out"]',
    ]
    texts = {
        ROBOT_FILE: "\n".join(lines),
        "split.toml": "\n".join(split),
        "model.xml": robot.model_xml.strip(),
    }
    for name, text in texts.items():
        (folder / name).write_text(text + "\n", encoding="utf-8")


def _strings(names: list[str]) -> str:
    return "[" + ", ".join(f'"{name}"' for name in names) + "]"


def write_logs(path: Path, logs: Logs) -> None:
    """Write all motions in one Parquet file, completely or not at all."""
    columns: dict[str, list[NDArray[Any]]] = {}

    def add(name: str, values: NDArray[Any]) -> None:
        columns.setdefault(name, []).append(values)

    for motion in logs.motions:
        first = next(iter(motion.joints.values())).position.time_s
        add("motion", np.full(first.size, motion.name))
        add("repeat", np.full(first.size, motion.repeat_of))
        add("t_s", first)
        for joint, log in motion.joints.items():
            assert log.command is not None
            assert log.temperature is not None
            add(f"command_{joint}", log.command.value)
            add(f"position_{joint}", log.position.value)
            add(f"temperature_{joint}", log.temperature.value)
    part = path.with_name(path.name + ".part")
    pq.write_table(pa.table({name: np.concatenate(parts) for name, parts in columns.items()}), part)
    os.replace(part, path)
