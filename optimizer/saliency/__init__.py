"""The position from the saliency of the inductances, at standstill too: injected voltages and
pulses.
"""
