; Time loop of a Taylor series: the function that the docstring of series_loop in taylor.py describes. Words that begin
; with a dollar sign are replaced there; the names of scalars in the replaced parts begin with %s.

define i64 @advance(ptr %work, ptr %out, ptr %params, double %h, i64 %steps, i64 %every, i64 %until) #0 {
entry:
$arrays
$pointers
  %hi0 = load $v, ptr %work, align 8
  %lo0 = load $v, ptr %lop, align 8
  %stepd = load double, ptr %stepp, align 8
  %step0 = fptosi double %stepd to i64
  %part0 = load double, ptr %partp, align 8
  %lag0 = load double, ptr %lagp, align 8
  %time = load double, ptr %timep, align 8
  %slevel = load double, ptr %levelp, align 8
  %count0 = load double, ptr %countp, align 8
$tables
  %unit = load $v, ptr %unitp, align 8
  %sh = fmul double %h, %time
  %size = call double @llvm.fabs.f64(double %sh)
  %inverse = fdiv double 1.0, %size
  br label %expand

; The series at the expansion point, hi + lo.
expand:
  %hi = phi $v [ %hi0, %entry ], [ $hi, %move ]
  %lo = phi $v [ %lo0, %entry ], [ $lo, %move ]
  %step = phi i64 [ %step0, %entry ], [ %stepnew, %move ]
  %part = phi double [ %part0, %entry ], [ %partnew, %move ]
  %slag = phi double [ %lag0, %entry ], [ %slagnew, %move ]
  %count = phi double [ %count0, %entry ], [ %countnew, %move ]
  %row0 = phi i64 [ %until, %entry ], [ %row, %move ]
  %place0 = phi ptr [ %out, %entry ], [ %place, %move ]
  %budget = phi i64 [ $budget, %entry ], [ %left, %move ]
$expansion
  %finite = fcmp olt double $late, 1024.0
  br i1 %finite, label %measure, label %broken

; Its reach in steps; one that is short is rounded, so that the next expansion point is exact.
measure:
  %natural = fmul double $natural, %inverse
  %capped = call double @llvm.minnum.f64(double %natural, double 0x4270000000000000)
  %long = fcmp oge double %capped, $exact
  %whole = call double @llvm.floor.f64(double %capped)
  %raised = fadd double %capped, $exact
  %short = fsub double %raised, $exact
  %shortend = fadd double %part, %short
  %reach = select i1 %long, double %whole, double %shortend
  %du = fsub double %reach, %part
  %moves = fcmp oge double %du, $shortest
  br i1 %moves, label %serve, label %stuck

; Rows within the reach are values of the polynomial.
serve:
  %row = phi i64 [ %row0, %measure ], [ %rownext, %write ]
  %place = phi ptr [ %place0, %measure ], [ %placenext, %write ]
  %within = icmp sle i64 %row, %steps
  %rowleft = sub i64 %row, %step
  %ahead = sitofp i64 %rowleft to double
  %reached = fcmp ole double %ahead, %reach
  %serves = and i1 %within, %reached
  br i1 %serves, label %write, label %served

write:
  %off = fsub double %ahead, %part
  %sp = fmul double %off, %sh
  %sd = fsub double %sp, %slag
$writing
  %tlo = fadd $v $written_rest, %lo
  %t = fadd $v $written, %tlo
  %there = fadd $v %hi, %t
  %physical = fmul $v %there, %unit
  %recorded = shufflevector $v %physical, $v poison, <$d x i32> <$first>
  store <$d x double> %recorded, ptr %place, align 8
  %rownext = add i64 %row, %every
  %placenext = getelementptr double, ptr %place, i64 $d
  br label %serve

served:
  %stepsleft = sub i64 %steps, %step
  %end = sitofp i64 %stepsleft to double
  %done = fcmp ole double %end, %reach
  br i1 %done, label %finish, label %move

; The next expansion point, and how far it lags behind its place in steps: the rounding error of du h.
move:
  %passed = call double @llvm.floor.f64(double %reach)
  %partnew = fsub double %reach, %passed
  %passedn = fptosi double %passed to i64
  %stepnew = add i64 %step, %passedn
  %sq = fmul double %du, %sh
  %sm = fsub double %sq, %slag
  %sqn = fneg double %sq
  %rest = call double @llvm.fmuladd.f64(double %du, double %sh, double %sqn)
  %gone = fsub double %sm, %sq
  %behind = fadd double %gone, %slag
  %slagnew = fsub double %behind, %rest
$moving
  %countnew = fadd double %count, 1.0
  %left = sub i64 %budget, 1
  %more = icmp sgt i64 %left, 0
  br i1 %more, label %expand, label %finish

; Keep what the next call needs.
finish:
  %result = phi i64 [ %steps, %served ], [ %stepnew, %move ]
  %hiend = phi $v [ %hi, %served ], [ $hi, %move ]
  %loend = phi $v [ %lo, %served ], [ $lo, %move ]
  %stepend = phi i64 [ %step, %served ], [ %stepnew, %move ]
  %partend = phi double [ %part, %served ], [ %partnew, %move ]
  %lagend = phi double [ %slag, %served ], [ %slagnew, %move ]
  %countend = phi double [ %count, %served ], [ %countnew, %move ]
  %after = sub i64 %stepend, %result
  %afterd = sitofp i64 %after to double
  store $v %hiend, ptr %work, align 8
  store $v %loend, ptr %lop, align 8
  store double %afterd, ptr %stepp, align 8
  store double %partend, ptr %partp, align 8
  store double %lagend, ptr %lagp, align 8
  store double %countend, ptr %countp, align 8
  ret i64 %result

; No convergence: the reach is too short. Return minus the number of the step that failed.
stuck:
  store double 0x7FF8000000000000, ptr %statusp, align 8
  br label %broken

broken:
  %behindit = icmp slt i64 %step, 0
  %before = select i1 %behindit, i64 0, i64 %step
  %failed = xor i64 %before, -1
  store $v %hi, ptr %work, align 8
  store double %count, ptr %countp, align 8
  ret i64 %failed
}

declare $v @llvm.fmuladd.v${lanes}f64($v, $v, $v)
declare double @llvm.fmuladd.f64(double, double, double)
$declarations
declare double @llvm.fabs.f64(double)
declare double @llvm.floor.f64(double)
declare double @llvm.minnum.f64(double, double)
declare i64 @llvm.vector.reduce.smax.v${lanes}i64(<$lanes x i64>)
attributes #0 = { nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" "no-builtins" }
