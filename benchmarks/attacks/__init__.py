"""Attacks on live engines: `field` is what they are made with, each other module holds those on one part."""
