from .voting import RawPoses as RawPoses
from .voting import VoteConfig as VoteConfig
from .voting import vote as vote
