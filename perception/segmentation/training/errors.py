"""Why a training ends early. A command that names the error need not load PyTorch for it."""


class TrainingError(RuntimeError):
    """The training cannot continue."""
