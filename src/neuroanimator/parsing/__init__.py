"""Formats that strangers' files come in, each bounded before it is parsed.

A function here takes the bytes of a file and raises ValueError with one line saying what is wrong; its
caller, who knows the file's name, says where. Nothing here takes a path or makes an object other than
plain dictionaries, lists, numbers, texts and arrays.
"""
