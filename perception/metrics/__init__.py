"""How good segments and poses are."""
