"""The program that confirms what is stated as proven, apart from all that states it."""
