"""All grammars, by the names under which their cases are counted."""

from collections.abc import Mapping
from types import MappingProxyType

from policies.soak.fuzz import arrays, commands, files, meshes, records
from policies.soak.fuzz.grammar import Grammar

GRAMMARS: Mapping[str, Grammar] = MappingProxyType(
    {
        "frames": arrays.frame,
        "camera matrices": arrays.intrinsics,
        "poses": arrays.pose,
        "meshes": meshes.mesh,
        "scenes": records.scene,
        "weights": records.weights,
        "records": records.record,
        "result folders": commands.result_folder,
        "clouds": files.cloud,
        "calibrations": files.calibration,
        "images": files.image,
        "command lines": commands.command_line,
        "perceive lines": commands.perceive_line,
    }
)
