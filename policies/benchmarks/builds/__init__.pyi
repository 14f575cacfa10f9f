from .comparison import BuildComparison as BuildComparison
from .comparison import compare_builds as compare_builds
from .comparison import save_comparison as save_comparison
from .inputs import BuildJob as BuildJob
from .paired import PairedTimes as PairedTimes
