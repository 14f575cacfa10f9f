from .names import GeneratedName as GeneratedName
from .names import held_out_parts as held_out_parts
from .names import is_generated as is_generated
from .names import parse_name as parse_name
from .names import training_parts as training_parts
from .registry import FAMILIES as FAMILIES
from .registry import HELD_OUT_FAMILIES as HELD_OUT_FAMILIES
from .registry import TRAINING_FAMILIES as TRAINING_FAMILIES
