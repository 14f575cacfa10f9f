"""Motion of the arm: inverse kinematics, paths, timing, collision checks."""
