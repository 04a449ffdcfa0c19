"""Vehicle and the presets: what is accepted, what is derived, and where the numbers come from."""

import dataclasses
import json
import math
from types import MappingProxyType

import numpy as np
import pytest

import bicycle_env
from bicycle_env import Vehicle, analysis
from bicycle_env.physics import presets
from bicycle_env.physics.presets import resolve_vehicle
from bicycle_env.physics.vehicle import UnitWarning

GIVEN = {
    "mass": 1500.0,
    "yaw_inertia": 2500.0,
    "cg_to_front": 1.2,
    "cg_to_rear": 1.6,
    "front_cornering_stiffness": 100e3,
    "rear_cornering_stiffness": 80e3,
}
NUMBERS = [field.name for field in dataclasses.fields(Vehicle) if field.name not in ("source", "name")]


def test_the_fields_are_the_six_of_the_book_and_the_body():
    assert NUMBERS[:6] == list(GIVEN)
    assert all(field.kw_only for field in dataclasses.fields(Vehicle))


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize(
    "bad", [math.nan, math.inf, -math.inf, 0.0, -1.0, 0, np.float64("nan"), np.array(-2.0)], ids=repr
)
def test_a_value_out_of_range_is_named(name, bad):
    with pytest.raises(ValueError, match=rf"^{name} must be a finite number in .*, got"):
        Vehicle(**(GIVEN | {name: bad}))


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("bad", ["heavy", None, True, [1500.0], np.array([1.0]), 1j, {}], ids=repr)
def test_a_value_of_the_wrong_type_is_named(name, bad):
    with pytest.raises(TypeError, match=rf"^{name} must be a finite number in .*, got"):
        Vehicle(**(GIVEN | {name: bad}))


def test_the_message_shows_the_bad_value():
    with pytest.raises(ValueError, match=r"got -3\.5"):
        Vehicle(**(GIVEN | {"mass": -3.5}))
    with pytest.raises(TypeError, match="heavy"):
        Vehicle(**(GIVEN | {"mass": "heavy"}))


@pytest.mark.parametrize("label", ["source", "name"])
def test_labels_must_be_text(label):
    with pytest.raises(TypeError, match=rf"^{label} must be a string, got 3"):
        Vehicle(**GIVEN, **{label: 3})


@pytest.mark.parametrize(
    ("wrong", "axle"),
    [
        ({"front_cornering_stiffness": 100e3 * math.pi / 180.0}, "front"),  # N/deg
        ({"rear_cornering_stiffness": 80.0}, "rear"),  # kN/rad
        ({"mass": 1.5}, "front"),  # t
        ({"cg_to_front": 0.0012}, "rear"),  # mm: its axle would carry hardly anything
    ],
)
def test_numbers_that_look_like_another_unit_are_remarked_on(wrong, axle):
    with pytest.warns(UnitWarning, match=rf"^{axle}_cornering_stiffness = .*N/deg or kN.*tonnes.*mm\?") as caught:
        car = Vehicle(**(GIVEN | wrong))
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert getattr(car, next(iter(wrong))) == next(iter(wrong.values()))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("coefficient", [3.001, 59.99])
def test_usual_numbers_are_not_remarked_on(coefficient):
    car = Vehicle(**GIVEN)
    dataclasses.replace(car, front_cornering_stiffness=coefficient * car.front_axle_load)
    for name in bicycle_env.vehicles:
        dataclasses.replace(bicycle_env.vehicles[name])
    scale = Vehicle(
        mass=3.0,
        yaw_inertia=0.05,
        cg_to_front=0.15,
        cg_to_rear=0.15,
        front_cornering_stiffness=150.0,
        rear_cornering_stiffness=150.0,
    )
    assert scale.wheelbase == 0.3


def test_the_name_is_a_label():
    mine, other = Vehicle(**GIVEN, name="mine"), Vehicle(**GIVEN, name="other")
    assert mine == other == Vehicle(**GIVEN)
    assert hash(mine) == hash(other)
    assert mine.name == "mine"


@pytest.mark.parametrize("bad", ["two\nlines", "\x1b[2J", "a" * 101])
def test_a_name_is_one_printable_line(bad):
    with pytest.raises(ValueError, match="name must be one line of at most 100 printable characters"):
        Vehicle(**GIVEN, name=bad)


@pytest.mark.parametrize(
    ("wrong", "right"), [("masss", "mass"), ("yaw_inertial", "yaw_inertia"), ("rear_overhangs", "rear_overhang")]
)
def test_an_unknown_keyword_is_answered_with_the_nearest(wrong, right):
    with pytest.raises(TypeError, match=rf"unknown keyword of Vehicle '{wrong}'; did you mean '{right}'\?"):
        Vehicle(**GIVEN, **{wrong: 1.0})


def test_a_missing_value_and_positional_values_are_refused():
    with pytest.raises(TypeError, match="yaw_inertia"):
        Vehicle(**{name: value for name, value in GIVEN.items() if name != "yaw_inertia"})
    with pytest.raises(TypeError):
        Vehicle(*GIVEN.values())


@pytest.mark.parametrize("name", NUMBERS)
def test_frozen(name):
    vehicle = Vehicle(**GIVEN)
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(vehicle, name, 1.0)


def test_a_value_object_of_plain_floats():
    vehicle = Vehicle(
        **{name: np.float32(value) for name, value in GIVEN.items()} | {"mass": 1500, "cg_to_rear": np.array(1.5)}
    )
    assert all(type(getattr(vehicle, name)) is float for name in NUMBERS)
    assert Vehicle(**GIVEN) == Vehicle(**GIVEN)
    assert hash(Vehicle(**GIVEN)) == hash(Vehicle(**GIVEN))
    assert dataclasses.replace(Vehicle(**GIVEN), mass=1600.0).mass == 1600.0


def test_derived_values_by_hand():
    vehicle = Vehicle(**GIVEN, front_overhang=0.8, rear_overhang=1.0)
    assert vehicle.wheelbase == pytest.approx(2.8, rel=1e-15)
    assert vehicle.front_axle_load == pytest.approx(1500 * 9.81 * 1.6 / 2.8, rel=1e-15)
    assert vehicle.rear_axle_load == pytest.approx(1500 * 9.81 * 1.2 / 2.8, rel=1e-15)
    assert vehicle.front_axle_load + vehicle.rear_axle_load == pytest.approx(14715.0, rel=1e-15)
    assert vehicle.front_extent == 2.0
    assert vehicle.rear_extent == 2.6
    assert vehicle.body_length == pytest.approx(4.6, rel=1e-15)


def test_critical_speed_by_hand():
    # a Cf - b Cr = 1.6 * 100e3 - 1.2 * 100e3 = 4e4; U^2 = 2.8^2 * 1e10 / (1500 * 4e4)
    vehicle = Vehicle(**(GIVEN | {"cg_to_front": 1.6, "cg_to_rear": 1.2, "rear_cornering_stiffness": 100e3}))
    assert vehicle.critical_speed == pytest.approx(math.sqrt(2.8**2 * 1e10 / (1500 * 4e4)), rel=1e-14)
    assert Vehicle(**(GIVEN | {"cg_to_front": 1.2, "cg_to_rear": 1.6})).critical_speed == math.inf


# The presets


def test_three_balances_of_one_body():
    cars = [bicycle_env.vehicles[name] for name in ("understeer", "neutral", "oversteer")]
    for name in ("mass", "yaw_inertia", "wheelbase", "cg_to_front", "body_width", "body_length"):
        assert len({getattr(car, name) for car in cars}) == 1, name
    gradients = [analysis.understeer_gradient(car) for car in cars]
    assert gradients[0] > 0.0 == gradients[1] > gradients[2]


def test_neutral_is_exactly_neutral():
    neutral = bicycle_env.vehicles["neutral"]
    assert (
        neutral.cg_to_front * neutral.front_cornering_stiffness == neutral.cg_to_rear * neutral.rear_cornering_stiffness
    )
    assert neutral.critical_speed == math.inf
    assert analysis.characteristic_speed(neutral) == math.inf


def test_oversteer_is_unstable_above_about_36_metres_per_second():
    assert bicycle_env.vehicles["oversteer"].critical_speed == pytest.approx(36.06, abs=0.01)


@pytest.mark.parametrize("name", bicycle_env.vehicles)
def test_every_preset_says_where_it_comes_from(name):
    vehicle = bicycle_env.vehicles[name]
    assert len(vehicle.source) > 40
    assert name.isidentifier()
    assert vehicle.name == name
    balance = "oversteer" if vehicle.critical_speed < math.inf else "understeer"
    stated = vehicle.source.lower()
    assert balance in stated or "cf" in stated
    if balance == "understeer":
        assert analysis.understeer_gradient(vehicle) >= 0.0


def test_the_mapping_cannot_be_changed():
    with pytest.raises(TypeError):
        bicycle_env.vehicles["mine"] = Vehicle(**GIVEN)


def test_an_unknown_name_is_answered_with_the_nearest():
    with pytest.raises(KeyError, match=r"vehicle must be one of .*, got 'cvic'; did you mean 'civic'\?"):
        bicycle_env.vehicles["cvic"]
    with pytest.raises(KeyError, match="vehicle must be one of"):
        bicycle_env.vehicles[3]
    assert "cvic" not in bicycle_env.vehicles
    assert bicycle_env.vehicles.get("cvic") is None


@pytest.fixture
def registering(monkeypatch):
    """What a test registers is gone after it."""
    monkeypatch.setattr(presets, "_vehicles", known := presets._Cars(presets._vehicles))
    monkeypatch.setattr(presets, "vehicles", MappingProxyType(known))
    return presets


def test_a_registered_vehicle_is_known(registering):
    bicycle_env.register_vehicle("mine", Vehicle(**GIVEN, name="another label"))
    assert registering.vehicles["mine"] == Vehicle(**GIVEN)
    assert registering.vehicles["mine"].name == "mine"
    assert resolve_vehicle("mine") is registering.vehicles["mine"]
    bicycle_env.register_vehicle("mine", GIVEN)  # the same again is no harm: a module may be imported twice
    with pytest.raises(ValueError, match=r"name must not be that of a different vehicle, got 'mine'"):
        bicycle_env.register_vehicle("mine", Vehicle(**GIVEN | {"mass": 1.0}))


@pytest.mark.parametrize("name", ["", "two words", "1st", "my-car", "car.toml", "a/b"])
def test_a_registered_name_is_one_word(registering, name):
    with pytest.raises(ValueError, match="name must be one word"):
        bicycle_env.register_vehicle(name, Vehicle(**GIVEN))
    assert set(registering.vehicles) == set(bicycle_env.vehicles)


@pytest.mark.parametrize(
    ("name", "vehicle", "text"), [(3, GIVEN, "name must be a string"), ("mine", "civic", "vehicle must be a Vehicle")]
)
def test_what_cannot_be_registered(registering, name, vehicle, text):
    with pytest.raises(TypeError, match=text):
        bicycle_env.register_vehicle(name, vehicle)


def test_resolve_vehicle():
    mine = Vehicle(**GIVEN)
    assert resolve_vehicle(mine) is mine
    assert resolve_vehicle("civic") is bicycle_env.vehicles["civic"]
    with pytest.raises(ValueError, match="did you mean 'oversteer'"):
        resolve_vehicle("oversteers")
    for bad in (3, None, ["civic"]):
        with pytest.raises(TypeError, match=r"vehicle must be one of .*, a car's file, a Vehicle or a dict, got"):
            resolve_vehicle(bad)


@pytest.mark.parametrize("name", bicycle_env.vehicles)
def test_the_plain_form_makes_the_car_again(name):
    car = bicycle_env.vehicles[name]
    again = resolve_vehicle(json.loads(json.dumps(dataclasses.asdict(car))))
    assert again == car
    assert again.name == name


def test_the_plain_form_takes_numpys_scalars():
    plain = {name: np.float32(value) for name, value in GIVEN.items()} | {"mass": np.int64(1500)}
    assert resolve_vehicle(plain) == Vehicle(**plain)


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"mas": 1.0}, ValueError, r"^unknown field of vehicle 'mas'; did you mean 'mass'\?"),
        ({3: 1.0}, ValueError, r"^unknown field of vehicle 3"),
        ({"mass": -1.0}, ValueError, r"^vehicle: mass must be"),
        ({"mass": "1500"}, TypeError, r"^vehicle: mass must be"),
    ],
)
def test_a_mistake_in_a_plain_form_is_named(change, error, text):
    with pytest.raises(error, match=text):
        resolve_vehicle(GIVEN | change)


def test_missing_fields_of_a_plain_form_are_named():
    with pytest.raises(ValueError, match=r"^vehicle: missing fields 'cg_to_front', 'cg_to_rear', 'front_corn"):
        resolve_vehicle({"mass": 1.0, "yaw_inertia": 1.0})


@pytest.mark.parametrize("inertia", [2.5, 2.5e6])
def test_a_yaw_inertia_in_another_unit_is_remarked_on(inertia):
    with pytest.warns(UnitWarning, match=r"^yaw_inertia = .*cars have 0.7 to 1.3.*t m\^2") as caught:
        car = Vehicle(**GIVEN | {"yaw_inertia": inertia})
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert car.yaw_inertia == inertia


def test_a_path_is_a_cars_file(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text("\n".join(f"{name} = {value}" for name, value in GIVEN.items()))
    assert resolve_vehicle(file) == resolve_vehicle(str(file))
