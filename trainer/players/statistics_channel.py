"""What players report of their episodes, over the statistics channel."""

from mlagents_envs.side_channel import IncomingMessage
from mlagents_envs.side_channel.stats_side_channel import StatsAggregationMethod, StatsSideChannel

from corridor_server.protocol.side_channels import read_statistic


class Statistics(StatsSideChannel):  # type: ignore[misc]  # mlagents_envs has no type information
    """``StatsSideChannel`` that refuses what is no statistic, where that one makes something of it."""

    def on_message_received(self, msg: IncomingMessage) -> None:
        """Keeps a statistic.

        Raises:
            SideChannelError: It is cut, or none.
        """
        name, value, aggregation = read_statistic(msg.get_raw_bytes())
        self.stats[name].append((value, StatsAggregationMethod(aggregation)))


class NoStatistics(StatsSideChannel):  # type: ignore[misc]
    """Takes statistics that nobody asked for, and keeps none, where ``mlagents_envs`` would warn of every message."""

    def on_message_received(self, msg: IncomingMessage) -> None:
        """Forgets a statistic."""
