"""The robot file: its model, its joints, and the columns of its logs, in TOML."""

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from simgap.common.errors import RobotError
from simgap.common.toml import Record, parse_record, read_toml
from simgap.units import COUNTS, SHARES, UNITS, Quantity, find_unit

Text = Annotated[str, Field(min_length=1)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
TimeStep = Annotated[float, Field(ge=1e-6, le=0.1)]
"""Below, a second is a million steps; above, no joint of a robot is simulated stably."""

POSITIONS = (Quantity.ANGLE, Quantity.LENGTH)
"""Quantity of a position: that of a hinge, that of a slide."""
SPEEDS = (Quantity.SPEED, Quantity.LINEAR_SPEED)
EFFORTS = (Quantity.TORQUE, Quantity.FORCE)
SIGNALS = {
    "position": POSITIONS,
    "velocity": SPEEDS,
    "torque": EFFORTS,
    "current": (Quantity.CURRENT,),
    "voltage": (Quantity.VOLTAGE,),
    "temperature": (Quantity.TEMPERATURE,),
    "secondary": POSITIONS,
    "enabled": (Quantity.FLAG,),
}
"""Signals of a joint beside its command, with the quantities that they may have. A mode is the signal that is
commanded."""

TOPIC_FIELDS = {
    "position": ("position", "rad"),
    "velocity": ("velocity", "rad/s"),
    "torque": ("effort", "N m"),
}
"""Signal or mode -> field of a JointState with it, and its unit."""


class SignalColumn(Record):
    """Column of a log that holds one signal of a joint."""

    column: Text
    """Name of the column, with `.field` for a field, and `[2]` or `[elbow]` for a place or name in a list; of
    messages the topic and the field, such as `/joint_states.position[elbow]`."""
    unit: Text
    """Unit of the logged values."""
    time_column: str = ""
    """Column of its own times, in the unit of [time]; empty: the time column of the file."""
    side: Literal["joint", "motor"] = "joint"
    """Side of the gear; values of the motor side are converted with the gear ratio."""
    factor: float = 1.0
    """Multiplies the logged value: -1 for a joint that counts the other way."""
    zero_rad: float = 0.0
    """Position of the joint in the model where the logged one is 0; m of a slide."""
    counts_per_turn: Positive | None = None
    """Counts of a turn, for the units count and count/s."""
    at_0_rad: float | None = None
    """Angle where the log has 0, for the units fraction and percent; m of a slide."""
    at_1_rad: float | None = None
    """Angle where the log has 1 or 100 %, for the units fraction and percent; m of a slide."""

    @model_validator(mode="after")
    def _check(self) -> "SignalColumn":
        if self.factor == 0.0:
            raise ValueError("factor is 0, which leaves nothing of the values; write another number")
        if (self.unit in COUNTS) != (self.counts_per_turn is not None):
            raise ValueError("counts_per_turn is needed for the units count and count/s, and for no other")
        is_share = self.unit in SHARES
        if is_share and (self.side != "joint" or self.factor != 1.0):
            raise ValueError(
                f"side and factor: with the unit {self.unit}, at_0_rad and at_1_rad say all of it; remove"
            )
        if (is_share, is_share) != (self.at_0_rad is not None, self.at_1_rad is not None):
            raise ValueError(
                "at_0_rad and at_1_rad are needed for the units fraction and percent, and for no other"
            )
        return self


class JointTable(Record):
    """Joint of the robot: its place in the model, its controller and its columns.

    Of a slide, each number in rad is in m, and each in N m is in N.
    """

    joint: str = ""
    """Joint of the MJCF model; empty: that with the name of this table."""
    actuator: str = ""
    """Actuator of the MJCF model; empty: the one that drives this joint."""
    mode: Literal["position", "velocity", "torque", "current", "voltage"]
    """What is commanded: position, velocity, torque, current, or the voltage of a `<dcmotor>`."""
    kp_Nm_rad: NotNegative | None = None
    """Stiffness of the position loop, with a gain column for a value of 1 in it; absent: of the model. Where
    torques are compared, no gain is needed."""
    kd_Nms_rad: NotNegative | None = None
    """Damping of the position or the velocity loop; absent: of the model."""
    gain_column: str = ""
    """Column with the gain of the position loop, one number in a motion; empty: the gain is constant."""
    torque_limit_Nm: Positive | None = None
    """Largest torque at the joint; absent: of the model."""
    gear_ratio: Positive = 1.0
    """Turns of the motor in a turn of the joint; of a slide, radians of the motor in 1 m."""
    torque_constant_Nm_A: Positive | None = None
    """Torque at the joint for 1 A; absent: that of a `<dcmotor>` of the model."""
    torque_constant_is_known: bool = True
    """False if the torque constant is a guess, so that it is fitted."""
    is_known: bool = False
    """True if friction, damping, armature and gain are measured numbers, so that none is fitted."""
    possible_rad: list[float] | None = None
    """Positions in the model between which a next motion may be commanded; absent: those of the logs."""
    topic: str = ""
    """Topic of messages such as JointState, which have this joint by the name of this table: its position,
    velocity and effort (as torque) are read in SI units, where no column of the signal is named."""
    command_topic: str = ""
    """Topic of such messages with the command, in the field of the mode."""
    position: SignalColumn
    """Angle that the encoder shows; of a slide the distance."""
    command: SignalColumn | None = None
    """Command of the mode; without it the logs need torques or a second encoder."""
    velocity: SignalColumn | None = None
    """Speed; the check compares it with the position."""
    torque: SignalColumn | None = None
    """Torque of the motor, as logged. If all joints with a command have it, torques are compared, not
    positions."""
    current: SignalColumn | None = None
    """Current of the motor; with a torque constant it stands for a torque that is not logged."""
    voltage: SignalColumn | None = None
    """Voltage of the supply; it limits how far the supply can sag."""
    temperature: SignalColumn | None = None
    """Temperature of the motor; friction and remainders may depend on it."""
    secondary: SignalColumn | None = None
    """Angle that a second encoder shows, on the other side of the gear."""
    enabled: SignalColumn | None = None
    """Whether the motor has power; without it the simulated motor has neither torque nor back-EMF."""

    def quantities(self) -> dict[str, tuple[Quantity, ...]]:
        """Return the quantities that each signal may have: where it has two, of a hinge and of a slide."""
        return {"command": SIGNALS[self.mode], **SIGNALS}

    def is_of_topic(self, column: SignalColumn) -> bool:
        """Tell whether a column is one of the topics, whose units are those of hinge or slide alike."""
        topics = tuple(f"{one}." for one in (self.topic, self.command_topic) if one)
        is_si = column.unit in {unit for _, unit in TOPIC_FIELDS.values()}
        return is_si and column.column.startswith(topics)

    def columns(self) -> dict[str, tuple[SignalColumn, Quantity]]:
        """Return the signals that are logged, by name, with the quantities of their units."""
        found = {name: getattr(self, name) for name in self.quantities()}
        return {name: (one, UNITS[one.unit].quantity) for name, one in found.items() if one is not None}

    @model_validator(mode="after")
    def _check(self) -> "JointTable":
        for name, quantities in self.quantities().items():
            one: SignalColumn | None = getattr(self, name)
            if one is None:
                continue
            try:
                find_unit(one.unit, *quantities)
            except ValueError as error:
                raise ValueError(f"{name}.unit: {error}") from error
            if one.zero_rad and quantities is not POSITIONS:
                said = " or ".join(quantities)
                raise ValueError(f"{name}.zero_rad: a value of {said} has no zero angle; remove it")
        if (reach := self.possible_rad) is not None and (len(reach) != 2 or reach[0] >= reach[1]):
            raise ValueError("possible_rad: write two positions, the lower one first")
        if self.gain_column and self.mode == "position" and self.kp_Nm_rad is None:
            raise ValueError("kp_Nm_rad: is missing; with a gain column it is the stiffness for a gain of 1")
        if self.mode == "voltage" and self.kp_Nm_rad is not None:
            raise ValueError("kp_Nm_rad: has no meaning in the mode voltage; remove it")
        if not self.torque_constant_is_known and (self.current is None or self.torque is not None):
            raise ValueError(
                "torque_constant_is_known: counts where a current stands for the torque; remove it"
            )
        return self


def columns_of_topics(joint: str, table: dict[str, Any]) -> dict[str, Any]:
    """Return the table of a joint with the columns of its topics, where it names none itself."""
    fields = dict.fromkeys(TOPIC_FIELDS, "topic") | {"command": "command_topic"}
    found = dict(table)
    for signal, key in fields.items():
        topic = table.get(key)
        field, unit = TOPIC_FIELDS.get(str(table.get("mode")) if signal == "command" else signal, ("", ""))
        if isinstance(topic, str) and topic and field and signal not in found:
            found[signal] = {"column": f"{topic}.{field}[{joint}]", "unit": unit}
    return found


class TimeTable(Record):
    """Times of the rows."""

    column: str = ""
    """Time column; empty: messages have their own times, a LeRobot data set has `timestamp`."""
    unit: Literal["s", "ms", "us", "ns"] = "s"
    """Unit of all time columns."""


class MotionTable(Record):
    """Columns that say which rows belong together."""

    columns: list[Text] = Field(default_factory=list)
    """Columns whose values together name a motion; empty: each file is a motion, of a LeRobot data set each
    episode. The file `logs/slow.csv` is the motion `slow`."""
    windows_s: dict[Text, Pair] = Field(default_factory=dict)
    """Name of a motion -> its start and end in seconds from the start of the log, in place of columns:
    `{ chirp = [2.0, 30.0] }`; the rest of the log is left out."""
    repeat_column: str = ""
    """Column whose value is the same in motions that repeat one another."""
    repeats: list[Annotated[list[Text], Field(min_length=2)]] = Field(default_factory=list)
    """Names of motions that repeat one another, in place of a column: `[["2", "7"]]`."""

    @model_validator(mode="after")
    def _check(self) -> "MotionTable":
        if self.columns and self.windows_s:
            raise ValueError("columns and windows_s exclude each other; give one of the two")
        if self.repeat_column and self.repeats:
            raise ValueError("repeat_column and repeats exclude each other; give one of the two")
        names = [name for group in self.repeats for name in group]
        twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
        if twice is not None:
            raise ValueError(
                f"repeats: {twice!r} stands there twice; put a motion and its repeats in one list"
            )
        for name, (start_s, end_s) in self.windows_s.items():
            if not 0.0 <= start_s < end_s:
                raise ValueError(
                    f"windows_s.{name}: ends at {end_s:g} s and starts at {start_s:g} s; write a start "
                    "from 0 on and a later end"
                )
        return self


class SettingTable(Record):
    """Number of the model that has the value of a condition."""

    element: Text
    """Element of the MJCF file, such as `geom`, `body` or `position`."""
    name: str = ""
    """Its name; empty: the only element of this kind, such as `option`."""
    attribute: Text
    """Attribute, such as `mass` or `size`; of an element inside it `inertial/mass`."""
    index: Annotated[int, Field(ge=0)] | None = None
    """Place in an attribute of several numbers, from 0, which the model must give; absent: it has one."""
    factor: float = 1.0
    """Number of the model for 1 in the log: 0.001 for grams."""
    offset: float = 0.0
    """Number of the model for 0 in the log."""


class ConditionTable(Record):
    """Number that differs from motion to motion: a mass, length, gain, temperature or supply.

    Motions of all its values form one diagnosis; a split may hold out a value, as `NAME=VALUE`.
    """

    column: str = ""
    """Column with the value, one number in a motion."""
    values: dict[Text, float] = Field(default_factory=dict)
    """Motion or log file -> its value, in place of a column: `{ unloaded = 0.0, loaded = 1.0 }`."""
    sets: list[SettingTable] = Field(default_factory=list)
    """Numbers of the model that have the value."""
    effects: list[Text] = Field(default_factory=list)
    """Effects that may act in proportion to the value less `neutral`, such as `payload`."""
    neutral: float = 0.0
    """Value at which these effects are absent."""
    possible: list[float] = Field(default_factory=list)
    """Values that a next motion may have too, such as masses at hand."""

    @model_validator(mode="after")
    def _check(self) -> "ConditionTable":
        if bool(self.column) == bool(self.values):
            raise ValueError("column and values: give one of the two")
        if self.possible and not self.sets and not self.effects:
            raise ValueError("possible: nothing follows this condition; give sets or effects, or remove it")
        names = [one.lower() for one in self.effects]
        if twice := [one for k, one in enumerate(names) if one in names[:k]]:
            raise ValueError(f"effects: {twice[0]!r} stands there twice; name it once")
        return self


class CsvTable(Record):
    """Format of CSV files."""

    separator: Annotated[str, Field(max_length=1)] = ""
    """Character between two columns; empty: found by the first rows."""
    decimal: Literal["", ".", ","] = ""
    """Character before the decimals of a number; empty: found by the first rows."""

    @model_validator(mode="after")
    def _check(self) -> "CsvTable":
        if self.separator and self.separator == self.decimal:
            raise ValueError(f"separator and decimal are both {self.decimal!r}; one of them is another")
        return self


class RobotFile(Record):
    """Content of a robot file."""

    name: Text
    """Name of the robot in reports."""
    model: Text
    """MJCF file, relative to the robot file."""
    left_out: list[Text] = Field(default_factory=list)
    """Joints of the model that are not diagnosed and stand where the model has them; a joint without a name
    has that of its body."""
    split: str = ""
    """File that says what is held out, relative to the robot file; empty: nothing is."""
    time_step_s: TimeStep
    """Step of the simulation."""
    control_rate_Hz: Positive
    """Rate of the inner control loop; its period is a whole number of time steps."""
    tool_site: str = ""
    """Site of the model that may touch a plane."""
    time: TimeTable = TimeTable()
    """Times of the rows."""
    motion: MotionTable = MotionTable()
    """Columns that say which rows belong together."""
    conditions: dict[Text, ConditionTable] = Field(default_factory=dict)
    """Numbers that differ from motion to motion, each a table by its name."""
    csv: CsvTable = CsvTable()
    """Format of CSV files."""
    joints: Annotated[dict[Text, JointTable], Field(min_length=1)]
    """The joints, each a table by its name."""

    @model_validator(mode="before")
    @classmethod
    def _add_columns(cls, content: Any) -> Any:
        """Name the columns of the joints that have topics."""
        joints = content.get("joints") if isinstance(content, dict) else None
        if not isinstance(joints, dict):
            return content
        named = {
            name: columns_of_topics(name, table) if isinstance(table, dict) else table
            for name, table in joints.items()
        }
        return {**content, "joints": named}

    @model_validator(mode="after")
    def _check(self) -> "RobotFile":
        steps = 1.0 / (self.control_rate_Hz * self.time_step_s)
        # A part in a million: steps such as 1/3000 s are written with a few digits.
        if round(steps) < 1 or abs(steps - round(steps)) > 1e-6 * steps:
            step_s = 1.0 / (self.control_rate_Hz * math.ceil(steps))
            raise ValueError(
                f"control_rate_Hz: its period is {steps:.6g} time steps; write time_step_s = {step_s:.9g}, "
                "or a rate whose period is a whole number of steps"
            )
        self._check_columns()
        return self

    def _check_columns(self) -> None:
        """Refuse a position that is the position, second position or command of another signal."""
        used: dict[str, str] = {}
        for joint, table in self.joints.items():
            for name in ("position", "secondary"):
                one: SignalColumn | None = getattr(table, name)
                if one is not None and used.setdefault(one.column, f"{joint}.{name}") != f"{joint}.{name}":
                    raise ValueError(
                        f"joints.{joint}.{name}.column: is that of joints.{used[one.column]} too"
                    )
        for joint, table in self.joints.items():
            if table.command is not None and table.command.column in used:
                raise ValueError(
                    f"joints.{joint}.command.column: is that of joints.{used[table.command.column]} too"
                )


class SerialFile(Record):
    """Content of the robot file of an arm whose tool poses a tracker measured: it has no MJCF model."""

    name: Text
    """Name of the arm."""
    serial_arm: Text
    """Arm file of the serial engine, relative to the robot file."""
    poses: dict[Text, Text]
    """Log file -> its mapping file, both by name; the mapping is relative to the robot file."""


def read_robot_file(path: Path) -> RobotFile | SerialFile:
    """Read a robot file; RobotError if it cannot be read, or a key or a value is wrong."""
    content = read_toml(path)
    if "serial_arm" in content:
        return parse_record(SerialFile, content, path)
    return parse_record(RobotFile, content, path)


def read_model_file(path: Path) -> RobotFile:
    """Read the robot file of a robot with an MJCF model; RobotError if it is wrong, or has no model."""
    found = read_robot_file(path)
    if isinstance(found, SerialFile):
        raise RobotError(
            f"{path}: serial_arm: has tracker poses and no MJCF model; `simgap diagnose` reads it"
        )
    return found
