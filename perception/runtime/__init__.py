"""What the library does beside its mathematics: caches, files, provenance, threads."""
