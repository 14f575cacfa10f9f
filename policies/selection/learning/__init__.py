"""Training of grasp selectors: MaskablePPO and a contextual bandit."""
