"""What is trained and judged on rooms, as names that a user chooses among."""

from typing import Literal

RowName = Literal["sgpn-colour", "dgcnn-colour", "dgcnn-new", "dgcnn-new-colour"]  # rows of Table 1 in its order
BudgetName = Literal["paper", "small"]  # paper: as it says; small: rows differ in trunk, colour and loss alone
Identity = Literal["ground_truth", "merged_ground_truth_blocks"]  # what no network can do better than
Population = Literal["room", "blocks"]  # the room's points, each once; or those of all blocks, as SGPN's code counts
