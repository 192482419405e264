"""The frames dqx and dqy of a machine over the angle, as tables for firmware."""
