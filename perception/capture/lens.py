"""The distortion of a lens, as calibrations state it: nothing that they state is left out."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from perception.capture.named_values import number_of, numbers_of
from perception.geometry import Floats

MODELS = ("plumb_bob", "rational_polynomial", "brown_conrady", "radtan", "opencv", "none", "")  # OpenCV's formula
# Parts of the names of models whose image is no pinhole camera's even where all coefficients are 0.
PROJECTIONS = ("fisheye", "equi", "kannala", "ftheta", "f_theta", "omni", "stereographic", "double_sphere", "eucm")
# Names in lower case without underscores, of which programs write several forms.
_LISTS = ("distortion", "coeffs", "distortioncoefficients", "distcoeffs", "distortioncoeffs", "dist", "d")
# The first of these that is stated is the model of the coefficients.
_MODELS = ("distortionmodel", "lensmodel", "distortiontype", "model")
_CAMERAS = ("cameramodel", "projectionmodel")  # they may name a camera, too
_SINGLE = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_ABOUT_LENS = re.compile(r"distort|fisheye|radial|tangential|^dist(?!ance)|^coef|^lens(?!$|name|id)")
_COEFFICIENT = re.compile(r"[kps]\d+|tau[xy]")  # names of single coefficients, or of matrices, which are something else


def distortion_of(values: Mapping[str, Any], name: str) -> Floats:
    """Return the coefficients that a calibration states, in OpenCV's order; none if it states none.

    Args:
        values: Named values of one camera.
        name: Name of the file, for messages.

    Raises:
        ValueError: The lens model is not OpenCV's, the coefficients contradict each other, or a value that is about the
            lens has an unknown name.
    """
    stated = {_plain(key): (key, value) for key, value in values.items() if value is not None}
    coefficients = _coefficients(stated, name)
    models = {key: _model(value) for key, (_, value) in stated.items() if key in (*_MODELS, *_CAMERAS)}
    model = next((models[key] for key in _MODELS if key in models), "")
    other = next((each for each in models.values() if any(part in each for part in PROJECTIONS)), None)
    if other is not None or (model not in MODELS and np.any(coefficients != 0)):
        raise ValueError(
            f"{name} must have a lens model of OpenCV's formula ({', '.join(filter(None, MODELS))}), got "
            f"{model if other is None else other!r} with coefficients {coefficients.tolist()}: let the camera's driver "
            "rectify the images, or calibrate with OpenCV"
        )
    for key, (written, value) in stated.items():
        known = key in (*_LISTS, *_MODELS, *_CAMERAS) or written in _SINGLE
        single = _COEFFICIENT.fullmatch(key) and isinstance(value, int | float | str)
        if not known and (single or _ABOUT_LENS.search(key)) and _says_something(value):
            raise ValueError(
                f"{name} states {written!r}, which is about the lens and must have a known name: write the "
                f"coefficients as distortion, in OpenCV's order {' '.join(_SINGLE)}, or let the camera's driver "
                f"rectify the images; got {value!r}"
            )
    return coefficients


def _coefficients(stated: Mapping[str, tuple[str, Any]], name: str) -> Floats:
    found = {stated[key][0]: numbers_of(stated[key][1], stated[key][0]) for key in _LISTS if key in stated}
    single = [key for key in _SINGLE if key in stated and stated[key][0] == key]
    if single:
        found[", ".join(single)] = np.array([number_of(stated[k][1], k) if k in single else 0.0 for k in _SINGLE])
    bent = {key: numbers for key, numbers in found.items() if np.any(numbers != 0)}
    if not bent:
        return next(iter(found.values()), np.zeros(0))
    first = next(iter(bent.values()))
    if any(not np.array_equal(_trimmed(first), _trimmed(numbers)) for numbers in bent.values()):
        raise ValueError(f"{name} must state the distortion once, got different values as {' and '.join(bent)}")
    return first


def _trimmed(numbers: Floats) -> Floats:
    return np.trim_zeros(numbers, "b")


def _plain(key: str) -> str:
    return key.lower().replace("_", "").replace("-", "")


def _model(value: Any) -> str:
    model = str(value).lower().rsplit(".", 1)[-1]
    return model.removeprefix("distortion_").replace(" ", "_")


def _says_something(value: Any) -> bool:
    """Return whether a value is more than zeros, an empty text or False."""
    if isinstance(value, Mapping):
        return any(_says_something(each) for each in value.values())
    if isinstance(value, str):
        return value.strip().lower() not in ("", "none", "false", "no", "0")
    return bool(np.any(np.asarray(value, object) != 0))
