from .folder_config import ensure_same_config as ensure_same_config
from .process_map import FolderWork as FolderWork
from .process_map import InputWork as InputWork
from .process_map import map_indices as map_indices
from .workers import Cluster as Cluster
from .workers import WorkerError as WorkerError
from .workers import Workers as Workers
