"""Tests of robots that are made of parts."""
