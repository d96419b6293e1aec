"""One interface for operators and networks: (light field, planes to focus on) -> stack."""
