"""Programs that ``corridor bench --peers`` runs, each a PPO on the corridor in a process of its own.

Those of others run in virtual environments that have neither this package nor what it needs: beside the peer they
import ``corridor_server.corridor``, and one another.
"""
