"""Strategies that draw terms and times, shared by the tests of the profiles."""

from hypothesis import strategies as st

from congelation.signals import Chirp, Constant, Noise, Sine, Square, Table, Telegraph

number = st.floats(-10.0, 10.0)
amplitude = number.filter(lambda a: a != 0.0)
phase = st.floats(-10.0, 10.0)
period = st.floats(1e-2, 50.0)
time = st.floats(-1e3, 1e3)

constants = st.builds(Constant, number)
sines = st.builds(Sine, amplitude, number, phase)
squares = st.builds(Square, amplitude, period, phase)
chirps = st.builds(Chirp, amplitude, number, number, period, phase)
telegraphs = st.builds(Telegraph, amplitude, st.floats(0.1, 5.0), st.integers(0, 2**31 - 1))
noises = st.builds(Noise, amplitude, st.floats(1e-2, 5.0), st.integers(0, 2**31 - 1))


@st.composite
def tables(draw):
    count = draw(st.integers(1, 6))
    gaps = draw(st.lists(st.floats(1e-2, 10.0), min_size=count, max_size=count))
    times = [draw(number)]
    for gap in gaps[1:]:
        times.append(times[-1] + gap)
    values = draw(st.lists(number, min_size=count, max_size=count))
    return Table(times, values, draw(st.booleans()))


terms = st.one_of(constants, sines, squares, chirps, telegraphs, noises, tables())
