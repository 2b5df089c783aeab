"""Open problems of co-simulation: small FMUs in C with exact or reference solutions.

parts.c     all FMUs
parts       builds them
problems    what they are coupled to, with the solutions
"""
