# From this folder to a bitstream:
#
#   vivado -mode batch -source build.tcl
#
# NOT RUN by those who wrote it, who have neither Vivado nor the board: see docs/boards.md for what was
# checked. Needs a Vivado with Virtex-7 devices; the XC7VX485T takes a licence.

set part xc7vx485tffg1761-2

create_project pearl_vc707 project -part $part -force
set_property target_language Verilog [current_project]

# ---- Sources, in the order of reading ----

set list [open sources.f]
set sources [split [string trim [read $list]] "\n"]
close $list
add_files -norecurse $sources
set_property file_type SystemVerilog [get_files *.sv]
add_files -fileset constrs_1 -norecurse vc707.xdc
set_property top pearl_vc707 [current_fileset]

# ---- XDMA: PCIe 2.0 x8, memory-mapped, one channel each way, one user interrupt, MSI ----

create_ip -vendor xilinx.com -library ip -name xdma -module_name pearl_xdma
set_property -dict [list \
    CONFIG.mode_selection {Advanced} \
    CONFIG.pcie_blk_locn {X1Y0} \
    CONFIG.pl_link_cap_max_link_width {X8} \
    CONFIG.pl_link_cap_max_link_speed {5.0_GT/s} \
    CONFIG.ref_clk_freq {100_MHz} \
    CONFIG.axi_data_width {128_bit} \
    CONFIG.axisten_freq {250} \
    CONFIG.xdma_axi_intf_mm {AXI_Memory_Mapped} \
    CONFIG.xdma_rnum_chnl {1} \
    CONFIG.xdma_wnum_chnl {1} \
    CONFIG.xdma_num_usr_irq {1} \
    CONFIG.axilite_master_en {false} \
    CONFIG.pf0_msi_enabled {true} \
    CONFIG.pf0_msix_enabled {false} \
    CONFIG.cfg_mgmt_if {false} \
    CONFIG.pf0_device_id {7028} \
] [get_ips pearl_xdma]

# ---- From 128 bits at 250 MHz to 256 bits at the design's clock ----

create_ip -vendor xilinx.com -library ip -name axi_dwidth_converter -module_name pearl_upsizer
set_property -dict [list \
    CONFIG.PROTOCOL {AXI4} \
    CONFIG.ADDR_WIDTH {32} \
    CONFIG.SI_DATA_WIDTH {128} \
    CONFIG.MI_DATA_WIDTH {256} \
    CONFIG.SI_ID_WIDTH {4} \
    CONFIG.FIFO_MODE {2} \
    CONFIG.ACLK_ASYNC {1} \
] [get_ips pearl_upsizer]

generate_target all [get_ips]
update_compile_order -fileset sources_1

# ---- Synthesis, implementation ----

launch_runs impl_1 -jobs 4
wait_on_run impl_1
set run [get_runs impl_1]
if {[get_property PROGRESS $run] ne "100%"} {
    error "implementation failed: see project/pearl_vc707.runs"
}
open_run impl_1
report_utilization -file utilization.rpt
report_methodology -file methodology.rpt

# ---- Gates: a design that may fail on the board gets no bitstream ----

proc refuse {what report} {
    error "$what: see $report; there is no bitstream"
}

# A constraint on what synthesis has renamed is dropped, with no more than a warning.
foreach pin {u_irq/irq_q_reg[0]/D u_reset/ready_q_reg[0]/CLR} {
    if {[llength [get_pins -quiet $pin]] != 1} {
        refuse "vc707.xdc constrains $pin, which is not there" "the log of synthesis"
    }
}

# Of the run's properties, the one for pulse widths is the sum of all that are too short.
report_timing_summary -report_unconstrained -file timing.rpt
foreach {property what mend} {
    STATS.WNS "timing is not met" ", or build it with fewer processing elements"
    STATS.WHS "hold times are not met" ""
    STATS.TPWS "clock pulses are too short" ""
} {
    set slack [get_property $property $run]
    if {![string is double -strict $slack] || $slack < 0} {
        refuse "$what, by $slack ns ($property)" "timing.rpt$mend"
    }
    set slacks($property) $slack
}
set unrouted [get_property STATS.FAILED_NETS $run]
if {$unrouted != 0} {
    report_route_status -file route.rpt
    refuse "$unrouted nets are not routed" route.rpt
}

# What crosses between the link's clock and the design's. Inside of it, XDMA answers for itself.
set core_clk [get_clocks -of_objects [get_pins u_core_clk_buffer/O]]
report_cdc -details -file cdc.rpt
foreach direction {-from -to} {
    set crossings [report_cdc $direction $core_clk -severity Critical -details -no_header -return_string]
    if {[string first Critical $crossings] >= 0} {
        refuse "signals cross between clocks unsafely, $direction $core_clk" cdc.rpt
    }
}

# Vivado only warns of a memory whose address or enable comes from a register with an asynchronous reset,
# though it can lose words (REQP-1839 and 1840). XDMA's own are XDMA's to judge.
report_drc -file drc.rpt
foreach violation [get_drc_violations -quiet] {
    set severity [get_property SEVERITY $violation]
    set corrupting [regexp {^REQP-(1839|1840)#} $violation]
    set cells [get_cells -quiet -of_objects $violation]
    if {$severity in {Fatal Error {Critical Warning}} || $corrupting && [lsearch -glob $cells u_pearl/*] >= 0} {
        refuse "design rule $violation is broken ($severity)" drc.rpt
    }
}

write_bitstream -force pearl_vc707.bit
puts "Wrote pearl_vc707.bit; $slacks(STATS.WNS) ns to spare, and $slacks(STATS.WHS) ns to hold"
