"""Long jobs: maps over worker processes or clusters, folders of results, and the formatting of tables and reports."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
