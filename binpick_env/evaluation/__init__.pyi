from .noise_fit import FrameObservation as FrameObservation
from .noise_fit import PartObservation as PartObservation
from .noise_fit import compare_with_truth as compare_with_truth
from .noise_fit import fit_noise as fit_noise
from .noise_fit import observe_bins as observe_bins
from .noise_fit import save_noise as save_noise
