"""What captures suffer from: seen, told and put right."""
