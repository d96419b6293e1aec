"""Disparity by matching views: at which slope they agree, one map that changes little, and its last hundredths."""
