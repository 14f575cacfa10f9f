from .soak import KillSoak as KillSoak
