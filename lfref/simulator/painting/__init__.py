"""From a scene to layers: surfaces painted as bitmaps, in their order, as large as they are seen."""
