"""Grasp candidates: antipodal grasps, the gripper, clearance."""
