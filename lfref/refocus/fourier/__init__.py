"""Refocusing of spectra, the views taken as periodic."""
