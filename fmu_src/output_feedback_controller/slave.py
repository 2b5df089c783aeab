from _shared.block import Block

__all__ = ["OutputFeedbackController"]


class OutputFeedbackController(Block):
    """The observer backstepping controller (45)-(55) on the ISS K-filter (28)-(33)."""

    # The wrapper drops a reference to this module's globals with every instance that it makes;
    # this function, made anew each time, holds one. Without it the host crashes.
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
