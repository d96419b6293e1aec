"""Scenes at random: the dice, and what is drawn of surfaces and of sensors."""
