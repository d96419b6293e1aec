"""Sharp pictures of the scene, and the slopes that it spans."""
