"""The paper's case studies, with statistics over seeds.

The data flows one way: ``plan`` (which runs) -> ``executors`` (a run is a ``worker``, a process) -> ``store`` (one
results place) -> ``results`` (numbers of each run) -> ``bootstrap`` -> ``claims`` -> ``figures`` and ``report``.
``study`` puts them together.
"""
