from .noise import FrameObservation as FrameObservation
from .noise import PartObservation as PartObservation
from .noise import compare_with_truth as compare_with_truth
from .noise import fit_general_noise as fit_general_noise
from .noise import fit_noise as fit_noise
from .noise import observe_bins as observe_bins
from .noise import save_noise as save_noise
