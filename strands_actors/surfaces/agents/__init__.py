"""Offer a robot as a tool to an agent or an MCP client. Its driver declares the tool, and the gate checks
its commands like those of every writer."""
