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
        friction=0.0,
    )
    harder = ("hand-eye 10 mm", "bin 300 x 200 x 100 mm", "jaw 60 mm", "friction 0")
    assert conditions(asdict(config)) == ("oracle", "sensor harsh", *harder)


def test_a_configuration_of_an_earlier_version_has_no_jaw_and_no_friction() -> None:
    values = asdict(EvaluationConfig())
    del values["jaw"], values["friction"]
    assert conditions(values) == ("learned", "sensor good")
