slTarget = 2000
IF ifStart
  START Axis
ENDIF
LOOP:
slShare = slShare + 1 * (slTarget - 3) / 2
WAIT slShare GT 5
JUMP LOOP
END
