"""Conversion of values by a mapping: units, gains, constants and the grid of 64 Hz."""

import io
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import parquet

from marsarm.telemetry.format import TICK_NS
from marsarm.telemetry.imports.job import ImportedLog, convert_table
from marsarm.telemetry.imports.mapping import MAX_TICK
from marsarm.telemetry.imports.units import UNIT_CONVERSIONS

GRID_S = np.arange(4) / 64


def mapped(mapping: str, time: str = 'unit = "s"', t: Any = GRID_S, **columns: Any) -> ImportedLog:
    sink = io.BytesIO()
    parquet.write_table(pa.table({"t": t} | columns), sink)
    head = f'[time]\ncolumn = "t"\n{time}\n'
    return convert_table(sink.getvalue(), "t.parquet", (head + mapping).encode(), "m.toml")


def one(name: str, rest: str) -> str:
    return f'[[channel]]\nname = "{name}"\n{rest}\n'


def values(made: ImportedLog) -> Any:
    (series,) = made.series
    return series.data[series.layout.fields[0].name]


@pytest.mark.parametrize(
    ("name", "unit", "given_value", "kept"),
    [
        ("arm.x_rad", "deg", 180.0, np.pi),
        ("arm.x_rad", "mrad", 250.0, 0.25),
        ("arm.x_rad_s", "rpm", 60.0, 2 * np.pi),
        ("arm.x_A", "mA", 1500.0, 1.5),
        ("arm.x_C", "K", 273.15, 0.0),
        ("arm.x_K", "degC", 0.0, 273.15),
        ("arm.x_Nm", "mN m", 2500.0, 2.5),
        ("arm.x_m", "mm", 12.5, 0.0125),
        ("arm.x_m_s2", "g0", 1.0, 9.80665),
        ("arm.x_s", "ms", 15.625, 1 / 64),
        ("arm.x_share", "%", 50.0, 0.5),
        ("arm.x_Pa", "hPa", 7.0, 700.0),
    ],
)
def test_units_are_converted_to_those_of_a_log(name: str, unit: str, given_value: float, kept: float) -> None:
    made = mapped(one(f"/imported/{name}", f'columns = "a"\nunit = "{unit}"'), a=[given_value] * 4)
    assert values(made) == pytest.approx(np.full(4, kept), rel=1e-15, abs=1e-15)


def test_every_unit_of_a_log_converts_to_itself() -> None:
    for unit, known in UNIT_CONVERSIONS.items():
        assert (known[unit].factor, known[unit].offset) == (1.0, 0.0), unit


def test_a_gain_and_an_offset_come_before_the_unit() -> None:
    rest = 'columns = ["a", "b", "c", "d", "e"]\nunit = "deg"\ngain = [1, -1, 1, 1, 2]\noffset = 90'
    made = mapped(one("/joint.motor_rad", rest), **{name: [45.0] * 4 for name in "abcde"})
    assert values(made)[0] == pytest.approx(np.radians([135, 45, 135, 135, 180]), rel=1e-15)


@given(st.lists(st.floats(width=64), min_size=4, max_size=4))
def test_what_needs_no_change_keeps_every_bit(bits: list[float]) -> None:
    made = mapped(one("/imported/arm.x_rad", 'columns = "a"\nunit = "rad"'), a=np.array(bits))
    assert values(made).tobytes() == np.array(bits).tobytes()


def test_counts_stay_whole_and_are_rounded_only_where_a_gain_asks_for_it() -> None:
    exact = one("/imported/arm.x_count", 'columns = "a"\nunit = "count"')
    assert values(mapped(exact, a=[0, 1 << 60, -5, 2])).tolist() == [0, 1 << 60, -5, 2]
    assert values(mapped(exact + "gain = 0.4\n", a=[0, 1, 2, 4])).tolist() == [0, 0, 1, 2]


@pytest.mark.parametrize(
    ("scale", "counts", "kept"),
    [
        ("gain = -1", [(1 << 60) + 1, -(1 << 60) - 1], [-(1 << 60) - 1, (1 << 60) + 1]),
        ("offset = 1", [(1 << 60) + 1, (1 << 63) - 2], [(1 << 60) + 2, (1 << 63) - 1]),
        ("gain = 3\noffset = -5", [(1 << 60) + 1, -7], [3 * (1 << 60) - 2, -26]),
    ],
)
def test_whole_gains_and_offsets_keep_every_bit_of_a_count(
    scale: str, counts: list[int], kept: list[int]
) -> None:
    mapping = one("/imported/arm.x_count", f'columns = "a"\nunit = "count"\n{scale}')
    assert values(mapped(mapping, t=GRID_S[:2], a=counts)).tolist() == kept


def test_linear_counts_lie_between_the_rows_however_large_and_far_apart() -> None:
    n = [-(1 << 63), (1 << 63) - 1, (1 << 60) + 1, (1 << 60) + 5]
    made = mapped(STEPS, 'unit = "s"\ngrid = "linear"', 2 * GRID_S, n=n)
    assert values(made).tolist()[::2] == n
    first, second, third = values(made).tolist()[1::2]
    assert (first, third) == (0, (1 << 60) + 3)
    assert second == pytest.approx((n[1] + n[2]) / 2, rel=1e-15)


def test_linear_numbers_between_finite_ones_are_finite() -> None:
    made = mapped(SPEED, 'unit = "s"\ngrid = "linear"', 2 * GRID_S[:2], a=[-1.5e308, 1.5e308])
    assert values(made).tolist() == [-1.5e308, 0.0, 1.5e308]


def test_infinities_of_the_table_stay() -> None:
    mapping = "[time]\nrate_Hz = 64\n" + one("/imported/arm.x_m", 'columns = "a"\nunit = "mm"')
    made = convert_table(b"a\ninf\n-Infinity\nnan\n", "t.csv", mapping.encode(), "m.toml")
    assert np.array_equal(values(made), [np.inf, -np.inf, np.nan], equal_nan=True)


def test_flags_may_be_numbers_and_may_be_turned_round() -> None:
    braked = one("/imported/arm.braked", 'columns = "a"\nunit = "bool"')
    assert values(mapped(braked, a=[0, 1, 1, 0])).tolist() == [False, True, True, False]
    turned = braked + "gain = -1\noffset = 1\n"
    assert values(mapped(turned, a=[True, False, True, True])).tolist() == [False, True, False, False]


@pytest.mark.parametrize("modes", [["STOWED", "GUARDED"] * 2, ["stowed", "Guarded"] * 2, [0, 3] * 2])
def test_modes_are_names_or_numbers(modes: list[Any]) -> None:
    assert values(mapped(one("/joint.mode", 'columns = "a"'), a=modes)).tolist() == [0, 3, 0, 3]


@pytest.mark.parametrize("mode", ["GUARDED", "guarded"])
def test_a_constant_mode_is_a_name_in_capitals_or_not(mode: str) -> None:
    made = mapped(
        one("/joint.mode", f'value = "{mode}"') + one("/joint.tick", 'columns = "a"'), a=[0, 1, 2, 3]
    )
    assert made.series[0].data["mode"].tolist() == [3] * 4


def test_a_constant_stands_in_every_message_and_the_cycle_counts() -> None:
    made = mapped(
        one("/sensors.current_A", 'columns = ["a", "b", "c", "d", "e"]\nunit = "A"')
        + one("/sensors.gravity_R_m_s2", 'value = [0, 0, 1]\nunit = "g0"')
        + one("/sensors.winding_C", 'value = 300\nunit = "K"')
        + one("/sensors.switch_closed", "value = false")
        + one("/sensors.cycle", 'value = "tick"'),
        time='unit = "s"\nfirst_tick = 7',
        **{name: [1.0] * 4 for name in "abcde"},
    )
    data = made.series[0].data
    assert data["cycle"].tolist() == [7, 8, 9, 10]
    assert data["gravity_R_m_s2"].tolist() == [[0.0, 0.0, 9.80665]] * 4
    assert data["winding_C"] == pytest.approx(np.full((4, 5), 26.85))
    assert not data["switch_closed"].any()


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_the_unit_of_the_time_is_that_of_the_column(unit: str) -> None:
    factor = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    t = np.arange(4) * 15_625_000 if unit == "ns" else GRID_S * factor
    made = mapped(
        one("/imported/arm.x_m", 'columns = "a"\nunit = "m"'), f'unit = "{unit}"', t + t[1], a=[1.0] * 4
    )
    assert made.series[0].ticks.tolist() == [0, 1, 2, 3]


def test_the_file_may_know_its_times() -> None:
    t = pa.array(np.arange(4) * 15_625_000 + 10**18, pa.timestamp("ns"))
    made = mapped(one("/imported/arm.x_m", 'columns = "a"\nunit = "m"'), "", t, a=[1.0] * 4)
    assert made.series[0].ticks.tolist() == [0, 1, 2, 3]


def test_rows_at_a_rate_need_no_time() -> None:
    sink = io.BytesIO()
    parquet.write_table(pa.table({"a": [1.0, 2.0, 3.0]}), sink)
    mapping = "[time]\nrate_Hz = 32\ngrid = 'nearest'\n" + one(
        "/imported/arm.x_m", 'columns = "a"\nunit = "m"'
    )
    made = convert_table(sink.getvalue(), "t.parquet", mapping.encode(), "m.toml")
    assert made.series[0].ticks.tolist() == [0, 2, 4]


@pytest.mark.parametrize("line", ["\n", "\r\n"])
def test_a_blank_line_is_a_row_without_a_value_except_at_the_end(line: str) -> None:
    mapping = "[time]\nrate_Hz = 64\n" + one("/imported/arm.x_m", 'columns = "a"\nunit = "m"')
    data = line.join(["a", "1", "", "3", "", ""]).encode()
    made = convert_table(data, "t.csv", mapping.encode(), "m.toml")
    assert made.rows == 3
    assert made.series[0].ticks.tolist() == [0, 2]
    assert values(made).tolist() == [1.0, 3.0]


def test_rows_may_be_put_in_order_and_the_report_can_say_so() -> None:
    mapping = one("/imported/arm.x_m", 'columns = "a"\nunit = "m"')
    made = mapped(mapping, 'unit = "s"\nsort = true', GRID_S[[0, 2, 1, 3]], a=[0.0, 2.0, 1.0, 3.0])
    assert values(made).tolist() == [0.0, 1.0, 2.0, 3.0]
    assert made.rows_moved == 3


AT_100_HZ = np.arange(9) / 100
SPEED = one("/imported/arm.x_m", 'columns = "a"\nunit = "m"')
STEPS = one("/imported/arm.n_count", 'columns = "n"\nunit = "count"')
MODE = one("/imported/arm.on", 'columns = "on"\nunit = "bool"')


def test_linear_is_between_the_rows_and_flags_are_held() -> None:
    a, n, on = 10.0 * AT_100_HZ, np.arange(9) * 1001, np.arange(9) % 2 == 1
    made = mapped(SPEED + STEPS + MODE, 'unit = "s"\ngrid = "linear"', AT_100_HZ, a=a, n=n, on=on)
    data, t = made.series[0].data, np.arange(6) / 64
    assert made.series[0].ticks.tolist() == list(range(6))
    assert data["x_m"] == pytest.approx(10 * t, rel=1e-12)
    assert data["n_count"].tolist() == np.rint(t * 100_100).astype(int).tolist()
    assert data["on"].tolist() == on[np.floor(t * 100).astype(int)].tolist()


def test_hold_is_the_last_row_before() -> None:
    made = mapped(SPEED, 'unit = "s"\ngrid = "hold"', AT_100_HZ, a=np.arange(9.0))
    assert values(made).tolist() == [0.0, 1.0, 3.0, 4.0, 6.0, 7.0]


@pytest.mark.parametrize("grid", ["hold", "linear"])
def test_rows_on_the_grid_keep_every_bit_whatever_comes_beside_them(grid: str) -> None:
    a = np.array([1.0, -0.0, np.nan, np.inf])
    assert values(mapped(SPEED, f'unit = "s"\ngrid = "{grid}"', a=a)).tobytes() == a.tobytes()


def test_a_channel_of_a_lower_rate_has_messages_where_it_has_values() -> None:
    columns = {"a": [1.0, 2.0, 3.0, 4.0], "b": [5.0, None, 6.0, None]}
    made = mapped(SPEED + one("/imported/slow.y_m", 'columns = "b"\nunit = "m"'), **columns)
    assert {s.topic: s.ticks.tolist() for s in made.series} == {
        "/imported/arm": [0, 1, 2, 3],
        "/imported/slow": [0, 2],
    }


def test_the_last_tick_of_the_last_table_fits_a_log() -> None:
    assert (2 * MAX_TICK) * TICK_NS < 2**64
