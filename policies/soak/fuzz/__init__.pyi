from .soak import FuzzSoak as FuzzSoak
