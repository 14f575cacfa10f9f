"""What is judged on S3DIS, and the table of the results."""
