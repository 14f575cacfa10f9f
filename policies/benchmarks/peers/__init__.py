"""Other libraries' pose estimation, as files that run in the libraries' own environments."""
