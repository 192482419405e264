"""What the drive is: quantities, input files, machine and inverter models,
modulators and loss models.
"""
