from dataclasses import asdict

from binpick_env.config import CameraConfig
from policies.evaluation.conditions import conditions
from policies.evaluation.config import EvaluationConfig


def test_what_differs_from_the_standard_cell_is_named() -> None:
    assert conditions(asdict(EvaluationConfig())) == ("learned", "sensor good")
    config = EvaluationConfig(
        perception="oracle",
        sensor="harsh",
        camera=CameraConfig(hand_eye=0.01),
        bin=(0.3, 0.2, 0.1),
        jaw=0.06,
        max_acceleration=4.0,
        max_jerk=50.0,
        friction=0.0,
    )
    limits = ("acceleration 4 rad/s^2", "jerk 50 rad/s^3")
    harder = ("hand-eye 10 mm", "bin 300 x 200 x 100 mm", "jaw 60 mm", *limits, "friction 0")
    assert conditions(asdict(config)) == ("oracle", "sensor harsh", *harder)


def test_a_configuration_of_an_earlier_version_has_no_jaw_and_no_friction() -> None:
    values = asdict(EvaluationConfig())
    for name in ("jaw", "friction", "max_acceleration", "max_jerk"):
        del values[name]
    assert conditions(values) == ("learned", "sensor good")
