"""The same scenes in Mitsuba 3, a renderer that the simulator is checked against; `world` needs the extra `mitsuba`."""
