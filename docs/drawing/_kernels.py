"""To be imported first: the same digits on every processor, as in a process of dqforge."""

from dqforge.reports.operating_system.system import prepare_process

prepare_process()
