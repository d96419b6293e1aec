"""Pure mathematics on tensors: no files, no state, no light fields."""
