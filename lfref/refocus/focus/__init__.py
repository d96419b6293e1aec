"""What is in focus, and where: sharpness of refocused planes."""
