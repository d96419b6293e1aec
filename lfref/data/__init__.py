"""Where light fields and label sources meet: sources, splits, cache, patches, data modules."""
