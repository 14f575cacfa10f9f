from .building import ScannedObject as ScannedObject
from .building import SynthesisConfig as SynthesisConfig
from .building import make_room as make_room
from .building import synthesize_rooms as synthesize_rooms
