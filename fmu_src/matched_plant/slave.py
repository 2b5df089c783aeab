from _shared.plant import Plant

__all__ = ["MatchedPlant"]


class MatchedPlant(Plant):
    """A plant under the matching condition."""

    # The wrapper drops a reference to this module's globals with every instance that it makes;
    # this function, made anew each time, holds one. Without it the host crashes.
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
