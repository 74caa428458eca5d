"""A run beside processes that take all the processor time they get: does its log still hold everything?"""
