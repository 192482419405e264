"""VESC's motor configuration: XML of VESC Tool and the header of custom builds."""
