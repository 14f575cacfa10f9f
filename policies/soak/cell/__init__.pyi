from .env import EnvSoak as EnvSoak
from .load import LoadSoak as LoadSoak
from .select import SelectSoak as SelectSoak
