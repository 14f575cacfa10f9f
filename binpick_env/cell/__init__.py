"""The simulated cell: model, physics, settling, and the judgement of deliveries."""
