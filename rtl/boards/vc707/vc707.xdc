# Xilinx VC707. Pins are those of the board's user guide (UG885), as public designs for the board have
# them too; lanes and reference clock are in the quads of PCIe block X1Y0, which build.tcl chooses.

# Bank 0, which configures the part, has 1.8 V on this board, so CFGBVS is at ground, as public designs for it say.
set_property CFGBVS GND [current_design]
set_property CONFIG_VOLTAGE 1.8 [current_design]

# PCIe: the reference clock of the edge connector, which is of 100 MHz, and PERST#.
set_property PACKAGE_PIN AB8 [get_ports pcie_clk_p]
set_property PACKAGE_PIN AB7 [get_ports pcie_clk_n]
create_clock -name pcie_clk -period 10.000 [get_ports pcie_clk_p]

set_property PACKAGE_PIN AV35 [get_ports pcie_perst_n]
set_property IOSTANDARD LVCMOS18 [get_ports pcie_perst_n]
set_property PULLUP true [get_ports pcie_perst_n]
set_false_path -from [get_ports pcie_perst_n]

# The lanes. The XDMA core places its transceivers; these say that it placed them where the board has them.
set_property PACKAGE_PIN Y4 [get_ports {pcie_rx_p[0]}]
set_property PACKAGE_PIN AA6 [get_ports {pcie_rx_p[1]}]
set_property PACKAGE_PIN AB4 [get_ports {pcie_rx_p[2]}]
set_property PACKAGE_PIN AC6 [get_ports {pcie_rx_p[3]}]
set_property PACKAGE_PIN AD4 [get_ports {pcie_rx_p[4]}]
set_property PACKAGE_PIN AE6 [get_ports {pcie_rx_p[5]}]
set_property PACKAGE_PIN AF4 [get_ports {pcie_rx_p[6]}]
set_property PACKAGE_PIN AG6 [get_ports {pcie_rx_p[7]}]

# User LEDs 0 to 2.
set_property PACKAGE_PIN AM39 [get_ports {led[0]}]
set_property PACKAGE_PIN AN39 [get_ports {led[1]}]
set_property PACKAGE_PIN AR37 [get_ports {led[2]}]
set_property IOSTANDARD LVCMOS18 [get_ports {led[*]}]
set_false_path -to [get_ports {led[*]}]

# The design's clock comes from the link's through a PLL that does not align the two. The converter's own
# constraints are for its crossing; besides it cross the interrupt, to a synchroniser, which gets a period of
# the link's clock to arrive, and the PLL's lock, which clears the reset's at any time.
set_max_delay -datapath_only -from [get_clocks -of_objects [get_pins u_core_clk_buffer/O]] \
    -to [get_pins {u_irq/irq_q_reg[0]/D}] 4.000
set_false_path -to [get_pins {u_reset/ready_q_reg[*]/CLR}]
