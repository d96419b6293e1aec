"""Wiener refocusing: the linear estimate of least mean square error, given which disparities a scene has."""
