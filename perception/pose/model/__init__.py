"""A part's models: edges, pair features, surface, near-symmetries."""
