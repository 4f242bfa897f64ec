// Files of deal.II 9.4: a bar of second order, stretched and twisted. DataOut writes each cell with points of its own:
// in linear pieces (build_patches(1)) and as Lagrange cells of order 2; .pvd by write_pvd_record.
// The integrals of each cell go to values.txt for make.py, which compiles and runs this program.
#include <deal.II/base/data_out_base.h>
#include <deal.II/base/function.h>
#include <deal.II/base/quadrature_lib.h>
#include <deal.II/dofs/dof_handler.h>
#include <deal.II/fe/fe_q.h>
#include <deal.II/fe/fe_system.h>
#include <deal.II/fe/fe_values.h>
#include <deal.II/grid/grid_generator.h>
#include <deal.II/grid/tria.h>
#include <deal.II/lac/vector.h>
#include <deal.II/numerics/data_out.h>
#include <deal.II/numerics/vector_tools.h>

#include <cmath>
#include <fstream>
#include <iomanip>

using namespace dealii;

struct Motion : Function<3>
{
  double t = 0;
  Motion() : Function<3>(3) {}
  double value(const Point<3> &X, const unsigned int component) const override
  {
    const double angle = M_PI / 3 * t * X[0] / 2, c = std::cos(angle), s = std::sin(angle);
    const double y = X[1] - 0.5, z = X[2] - 0.5;
    if (component == 0)
      return 0.2 * t * X[0];
    return component == 1 ? 0.5 + c * y - s * z - X[1] : 0.5 + s * y + c * z - X[2];
  }
};

void run(const unsigned int degree, const bool high_order, const std::string &name, std::ofstream &values)
{
  Triangulation<3> mesh;
  GridGenerator::subdivided_hyper_rectangle(mesh, {2u, 1u, 1u}, Point<3>(0, 0, 0), Point<3>(2, 1, 1));
  mesh.begin_active()->set_refine_flag();
  mesh.execute_coarsening_and_refinement(); // a hanging node: eight small cells beside a large one
  const FESystem<3> element(FE_Q<3>(degree), 3);
  DoFHandler<3> dofs(mesh);
  dofs.distribute_dofs(element);
  Vector<double> u(dofs.n_dofs());
  Motion motion;
  const QGauss<3> rule(5);
  FEValues<3> at(element, rule, update_gradients | update_JxW_values);
  const FEValuesExtractors::Vector displacement(0);
  std::vector<Tensor<2, 3>> gradients(rule.size());
  std::vector<std::pair<double, std::string>> record;
  const double times[] = {0, 0.25, 0.5, 1};
  for (unsigned int k = 0; k < 4; ++k)
    {
      motion.t = times[k];
      VectorTools::interpolate(dofs, motion, u);
      DataOut<3> out;
      const std::vector<DataComponentInterpretation::DataComponentInterpretation> vector(
        3, DataComponentInterpretation::component_is_part_of_vector);
      out.attach_dof_handler(dofs);
      out.add_data_vector(u, std::vector<std::string>(3, "displacement"), DataOut<3>::type_dof_data, vector);
      DataOutBase::VtkFlags flags;
      flags.write_higher_order_cells = high_order;
      flags.time = times[k];
      flags.cycle = k;
      out.set_flags(flags);
      out.build_patches(degree);
      const std::string file = name + "_" + std::to_string(k) + ".vtu";
      std::ofstream stream(file);
      out.write_vtu(stream);
      record.emplace_back(times[k], file);
      unsigned int number = 0;
      for (const auto &cell : dofs.active_cell_iterators())
        {
          at.reinit(cell);
          at[displacement].get_function_gradients(u, gradients);
          double rest = 0, volume = 0;
          Tensor<2, 3> mean;
          for (unsigned int q = 0; q < rule.size(); ++q)
            {
              const Tensor<2, 3> F = gradients[q] + Tensor<2, 3>(unit_symmetric_tensor<3>());
              rest += at.JxW(q);
              volume += determinant(F) * at.JxW(q);
              mean += at.JxW(q) * F;
            }
          mean /= rest;
          values << std::setprecision(16) << name << ' ' << k << ' ' << number++ << ' ' << rest << ' ' << volume << ' '
                 << cell->center() << ' ' << mean << '\n';
        }
    }
  std::ofstream pvd(name + ".pvd");
  DataOutBase::write_pvd_record(pvd, record);
}

int main()
{
  std::ofstream values("values.txt");
  run(1, false, "linear", values);
  run(2, true, "lagrange", values);
}
