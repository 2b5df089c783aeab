"""Whether a run or a design is right: reference solutions, certificates, metrics of a loop."""
