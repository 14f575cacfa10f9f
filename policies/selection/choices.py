"""What a user chooses among when selectors are compared."""

HEURISTICS = ("random", "highest", "best_score", "weighted")  # names of the selectors that need no training
