"""The position from the saliency of the inductances, at standstill too: injected voltages, pulses,
and the polarity of the magnet.
"""
