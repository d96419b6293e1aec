"""Views read wherever a pixel of the picture asks for it: surfaces, cameras that stand anywhere."""
