"""Units of logged values."""

import math

import pytest

from simgap.units import UNITS, Quantity, find_unit


@pytest.mark.parametrize(
    ("name", "quantity", "logged", "expected"),
    [
        ("deg", Quantity.ANGLE, 180.0, math.pi),
        ("turn", Quantity.ANGLE, 0.5, math.pi),
        ("mrad", Quantity.ANGLE, 1.0, 1e-3),
        ("rpm", Quantity.SPEED, 60.0, 2 * math.pi),
        ("deg/s", Quantity.SPEED, 180.0, math.pi),
        ("mN m", Quantity.TORQUE, 5.0, 5e-3),
        ("mA", Quantity.CURRENT, 5.0, 5e-3),
        ("K", Quantity.TEMPERATURE, 273.15, 0.0),
        ("us", Quantity.TIME, 1.0, 1e-6),
        ("g0", Quantity.ACCELERATION, 1.0, 9.80665),
        ("%", Quantity.RATIO, 50.0, 0.5),
    ],
)
def test_a_value_is_converted_to_si_units(name, quantity, logged, expected):
    unit = find_unit(name, quantity)
    assert unit.factor * logged + unit.offset == pytest.approx(expected)


def test_every_quantity_has_its_si_unit():
    plain = {one.quantity for one in UNITS.values() if (one.factor, one.offset) == (1.0, 0.0)}
    assert plain == set(Quantity)


def test_a_unit_of_another_quantity_is_refused_with_the_nearest():
    with pytest.raises(ValueError, match="'N m' is no unit of angle; write one of rad, mrad, urad, deg"):
        find_unit("N m", Quantity.ANGLE)
    with pytest.raises(ValueError, match="did you mean 'deg'"):
        find_unit("degs", Quantity.ANGLE)
