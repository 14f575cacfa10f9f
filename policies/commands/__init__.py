"""The command line: ``binpick``, one module a command. Nothing here is for other programs to import."""

__all__: list[str] = []
