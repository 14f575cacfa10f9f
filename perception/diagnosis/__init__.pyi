from .bin_facts import BinFacts as BinFacts
from .frame_diagnosis import diagnose as diagnose
from .log import log_causes as log_causes
from .report import Cause as Cause
from .report import CauseName as CauseName
from .report import FrameReport as FrameReport
from .report import PoseCounts as PoseCounts
