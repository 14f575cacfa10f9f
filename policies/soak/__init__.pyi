from .cell import EnvSoak as EnvSoak
from .cell import SelectSoak as SelectSoak
from .fuzz import FuzzSoak as FuzzSoak
from .kill import KillSoak as KillSoak
from .run import run_soak as run_soak
from .run import soak_table as soak_table
from .unit import Soak as Soak
from .unit import UnitResult as UnitResult
