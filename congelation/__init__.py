"""Adaptive control of linear systems with time-varying parameters, co-simulated under FMI 2.0.

The method (congelation of variables) and its equation numbers are those of K. Chen and
A. Astolfi, Adaptive Control of Linear Systems with Time-Varying Parameters, American Control
Conference 2018; "the paper" means this one throughout.
"""
