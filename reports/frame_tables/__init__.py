"""Tables of the frames dqx and dqy, as C, tables, JSON and text."""
