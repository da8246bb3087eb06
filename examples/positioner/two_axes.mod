; Goes through the places of a recipe, one axis after the other.
speed[1] = 50000
placeX[1, 1] = 600
placeY[1, 1] = 300
placeX[1, 2] = 200
placeY[1, 2] = 400
IF slPart EQ 0
  slPart = 1
ENDIF
AxisX:measure = 10000
AxisY:measure = 10000
AxisX:pulse = 40000
AxisY:pulse = 40000
AxisX:maxvel = 100000
AxisY:maxvel = 100000
AxisX:maxpos = 10000
AxisY:maxpos = 10000
AxisX:maxfollerr = 10000
AxisY:maxfollerr = 10000
AxisX:taccdec = 50
AxisY:taccdec = 50
AxisX:toll = 5
AxisY:toll = 5
AxisX:pgain = 50
AxisY:pgain = 50
AxisX:feedfw = 1000
AxisY:feedfw = 1000
INIT AxisX                     ; one after the other: only one device at a time writes to the drive
LOOPON AxisX
REGOFF AxisX
WAIT AxisX:st_regoff
INIT AxisY
LOOPON AxisY
REGOFF AxisY
WAIT AxisY:st_regoff
gbStep = 1
NEXT:
ofMotorX = 1
tmSettle = 50                  ; ms until its contacts are at rest
WAIT tmSettle
REGON AxisX
AxisX:setvel = speed[slPart]
AxisX:setpos = placeX[slPart, gbStep]
WAIT NOT AxisX:st_regoff
START AxisX
WAIT AxisX:st_still AND AxisX:st_toll
REGOFF AxisX
WAIT AxisX:st_regoff
ofMotorX = 0
ofMotorY = 1
tmSettle = 50
WAIT tmSettle
REGON AxisY
AxisY:setvel = speed[slPart]
AxisY:setpos = placeY[slPart, gbStep]
WAIT NOT AxisY:st_regoff
START AxisY
WAIT AxisY:st_still AND AxisY:st_toll
REGOFF AxisY
WAIT AxisY:st_regoff
ofMotorY = 0
gbStep = gbStep + 1
IF gbStep LE 2
  JUMP NEXT
ENDIF
END
