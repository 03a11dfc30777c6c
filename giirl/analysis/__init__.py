"""Tests of a learned reward: does it follow the goal when the goal changes, and how does it score episodes?"""
