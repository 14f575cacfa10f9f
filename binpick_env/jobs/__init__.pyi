from .folder_config import ensure_same_config as ensure_same_config
from .process_map import WorkerError as WorkerError
from .process_map import map_indices as map_indices
