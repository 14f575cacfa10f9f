"""From a labelled capture to pose candidates: perceivers that read pixels, and oracles."""
