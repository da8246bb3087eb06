; Homes, positions and jogs one axis.
Axis:measure = 10000           ; um for
Axis:pulse = 40000             ; encoder edges
Axis:maxvel = 100000           ; um/min at 10 V
Axis:unitvel = 0
Axis:decpt = 0
Axis:maxpos = 999999
Axis:minpos = -999999
Axis:maxfollerr = 10000        ; edges
Axis:rampmode = 0
Axis:ramptype = 0
Axis:taccdec = 100             ; 1 s from rest to maxvel
Axis:tinvt = 10                ; 0.1 s before it turns about
Axis:toll = 5
Axis:toldly = 10
Axis:prsmode = 0
Axis:prspos = 0
Axis:prmdir = 0
Axis:prsvel = 20 * Axis:maxvel / 100
Axis:sprsvel = 10 * Axis:maxvel / 100
Axis:offset = 0
Axis:pgain = 50
Axis:feedfw = 1000
Axis:integt = 0
Axis:derivt = 0
INIT Axis
WAIT Axis:st_init
CNTUNLOCK Axis
CNTDIR Axis
WAIT NOT (Axis:st_cntlock OR Axis:st_cntrev)
IF Axis:st_regoff
  REGON Axis
ENDIF
IF Axis:st_emrg
  RESUME Axis
ENDIF
LOOPON Axis
WAIT Axis:st_loopon
IF slShare EQ 0
  slShare = 50
ENDIF
IF slTarget EQ 0
  slTarget = nearEnd
ENDIF

MAIN:
ofThere = Axis:st_toll
ofStill = Axis:st_still
IF ifStop AND NOT Axis:st_still
  STOP Axis
ENDIF
IF Axis:st_still AND NOT (gfJogging OR Axis:st_prson)
  gfPlacing = 0
  Axis:setvel = slShare * Axis:maxvel / 100
  IF ifHome
    PRESET Axis
  ELSE
    IF ifStart
      Axis:setpos = slTarget
      START Axis
      gfPlacing = 1
    ENDIF
    IF ifForward AND NOT gfPlacing
      MANFW Axis
      gfJogging = 1
    ENDIF
    IF ifBack AND NOT (gfPlacing OR gfJogging)
      MANBW Axis
      gfJogging = 1
    ENDIF
  ENDIF
ENDIF
IF gfJogging AND NOT (ifForward OR ifBack)
  IF NOT Axis:st_still
    STOP Axis
  ENDIF
  gfJogging = 0
ENDIF
WAIT 1
JUMP MAIN
END
