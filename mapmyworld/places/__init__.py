"""Have we been here before?"""
