from .env import EnvSoak as EnvSoak
from .select import SelectSoak as SelectSoak
