"""Files of ST's MCSDK: parameter headers, motor file of Workbench 6, project of Workbench 5."""
