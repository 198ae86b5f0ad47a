"""The ML-Agents protocol, as both ends speak it: messages, their quick reading and writing, side channels."""
