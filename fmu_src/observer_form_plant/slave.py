from _shared.plant import Plant

__all__ = ["ObserverFormPlant"]


class ObserverFormPlant(Plant):
    """A plant in observable canonical form (27)."""

    # The wrapper drops a reference to this module's globals with every instance that it makes;
    # this function, made anew each time, holds one. Without it the host crashes.
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
