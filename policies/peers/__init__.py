"""Other people's pose estimation, run by its own interpreter: nothing here imports the project, nor it this."""
