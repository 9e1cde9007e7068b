"""The motion of rolling balls: closed forms, numerical where there are none, impacts; one run or thousands."""
