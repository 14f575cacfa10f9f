"""The depth camera: rendering, sensor noise and the frames it delivers."""
