from .bodies import BodyConfig as BodyConfig
from .bodies import BodyModel as BodyModel
from .bodies import body_model as body_model
from .explanation import ExplanationConfig as ExplanationConfig
from .explanation import PosedPart as PosedPart
from .explanation import explain_segments as explain_segments
from .greedy import PoseSource as PoseSource
from .greedy import select_poses as select_poses
