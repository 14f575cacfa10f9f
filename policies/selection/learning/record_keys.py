"""Keys of training configurations in saved files, under their present and their former names."""

from collections.abc import Mapping
from typing import Any

# Present name of each setting that had another one before; both are written until the next minor version.
PPO_KEYS = {
    "n_steps": "rollout",
    "batch_size": "batch",
    "n_epochs": "epochs",
    "learning_rate": "rate",
    "gamma": "discount",
    "ent_coef": "entropy",
}
BANDIT_KEYS = {"batch_size": "batch", "learning_rate": "rate", "weight_decay": "decay"}


def with_former_keys(values: Mapping[str, Any], former: Mapping[str, str]) -> dict[str, Any]:
    """Return ``values`` with each renamed setting under its former name as well.

    Args:
        values: Settings under their present names.
        former: Former name of each renamed setting, by present name.
    """
    return {**values, **{old: values[new] for new, old in former.items()}}


def without_former_keys(values: Mapping[str, Any], former: Mapping[str, str]) -> dict[str, Any]:
    """Return settings read from a file under their present names alone, whichever version wrote the file.

    Args:
        values: Settings under present names, former names or both.
        former: Former name of each renamed setting, by present name.
    """
    present = {old: new for new, old in former.items()}
    kept = {name: value for name, value in values.items() if name not in present}
    return {**{present[name]: value for name, value in values.items() if name in present}, **kept}
