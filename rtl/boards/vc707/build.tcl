# From this folder to a bitstream:
#
#   vivado -mode batch -source build.tcl
#
# NOT RUN by those who wrote it, who have neither Vivado nor the board: see docs/boards.md for what was
# checked. Needs a Vivado with Virtex-7 devices; the XC7VX485T takes a licence.

set part xc7vx485tffg1761-2

create_project pearl_vc707 project -part $part -force
set_property target_language Verilog [current_project]

# ---- Sources, in the order of reading; the header's macros are for all of them ----

set list [open sources.f]
set sources [split [string trim [read $list]] "\n"]
close $list
add_files -norecurse $sources
set_property file_type SystemVerilog [get_files *.sv]
set_property file_type {Verilog Header} [get_files pearl_build.svh]
set_property is_global_include true [get_files pearl_build.svh]
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

# ---- Synthesis, implementation, bitstream; a design that is too slow is no result ----

launch_runs impl_1 -to_step write_bitstream -jobs 4
wait_on_run impl_1
if {[get_property PROGRESS [get_runs impl_1]] ne "100%"} {
    error "implementation failed: see project/pearl_vc707.runs"
}
open_run impl_1
report_utilization -file utilization.rpt
report_timing_summary -file timing.rpt
set slack [get_property STATS.WNS [get_runs impl_1]]
if {$slack < 0} {
    error "timing is not met, by $slack ns: see timing.rpt, and build it with fewer processing elements"
}
file copy -force project/pearl_vc707.runs/impl_1/pearl_vc707.bit pearl_vc707.bit
puts "Wrote pearl_vc707.bit; timing is met with $slack ns to spare"
