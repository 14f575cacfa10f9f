"""Inverse kinematics, grasps, the scripted picker and its evaluation."""
